# SPDX-License-Identifier: Apache-2.0
"""The devices of the contract, and a host for each."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from deltacharger_core.servo_types import MX_64, TYPES, ServoType
from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.errors import DriverError
from deltacharger_driver.servos.bus import ServoBus, set_up
from deltacharger_driver.servos.link import ServoLink

from ...firmware.build import host_programs
from ...marks import rest
from .host import BoardHost
from .sites import BoardSite, ServoSite, emulated_board, emulated_servos, firmware_board


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "servo_kind" in metafunc.fixturenames:
        others = () if metafunc.config.getoption("--port") else (kind for kind in TYPES.values() if kind is not MX_64)
        metafunc.parametrize("servo_kind", [MX_64, *map(rest, others)], ids=lambda kind: kind.name)
    if "board_kind" in metafunc.fixturenames:
        kinds = ["port"] if metafunc.config.getoption("--port") else ["emulator", rest("firmware")]
        metafunc.parametrize("board_kind", kinds)


@pytest.fixture(scope="session")
def ports(pytestconfig: pytest.Config) -> dict[str, str]:
    """The paths given with --port, by device; empty over the emulators."""
    return dict(pytestconfig.getoption("--port"))


def opened(device: str, ports: dict[str, str], open: Callable[[str], None]) -> str:
    """Return the device's port after opening it once: skip without one, fail with the driver's reason."""
    if device not in ports:
        pytest.skip(f"no --port {device}=PATH was given")
    try:
        open(ports[device])
    except DriverError as error:
        pytest.fail(str(error), pytrace=False)
    return ports[device]


def open_servos(path: str) -> ServoType:
    bus = ServoBus(ServoSite(path, real=True).settings)
    bus.open()
    bus.close()
    return bus.drive.servo


def open_board(path: str) -> None:
    with BoardLink(path):
        pass


@pytest.fixture(scope="session")
def real_servos(ports: dict[str, str]) -> ServoSite:
    kinds: list[ServoType] = []
    path = opened("servo", ports, lambda path: kinds.append(open_servos(path)))
    return ServoSite(path, real=True, kind=kinds[0])


@pytest.fixture(scope="session")
def real_board(ports: dict[str, str]) -> str:
    return opened("board", ports, open_board)


@pytest.fixture
def servo_site(request: pytest.FixtureRequest, ports: dict[str, str], servo_kind: ServoType) -> Iterator[ServoSite]:
    """The servos of this run; emulated ones of each type."""
    if ports:
        yield request.getfixturevalue("real_servos")
    else:
        with emulated_servos(servo_kind) as site:
            yield site


@pytest.fixture
def board_site(request: pytest.FixtureRequest, board_kind: str, tmp_path: Path) -> Iterator[BoardSite]:
    """The board of this run."""
    if board_kind == "port":
        yield BoardSite(request.getfixturevalue("real_board"), real=True)
    elif board_kind == "emulator":
        with emulated_board() as site:
            yield site
    else:
        with firmware_board(host_programs() / "board_host", tmp_path / "board") as site:
            yield site


@pytest.fixture
def may_move(pytestconfig: pytest.Config, ports: dict[str, str]) -> None:
    """Skip on real servos, unless they may be moved."""
    if "servo" in ports and not pytestconfig.getoption("--move"):
        pytest.skip("switches torque on and moves the arm by a few degrees: only with --move")


@pytest.fixture
def load_connected(pytestconfig: pytest.Config) -> bool:
    """Whether a load is connected to a real board's electrodes, by option."""
    return bool(pytestconfig.getoption("--close-contactor"))


@pytest.fixture
def may_close(ports: dict[str, str], load_connected: bool) -> None:
    """Skip on a real board, unless its contactor may be closed."""
    if "board" in ports and not load_connected:
        pytest.skip("asks for the contactor to be closed: only with --close-contactor, and a load connected")


@pytest.fixture
def bus(servo_site: ServoSite) -> Iterator[ServoBus]:
    """The servos configured for the cycle, torque off before and after."""
    bus = ServoBus(servo_site.settings)
    bus.open()
    yield bus
    with contextlib.suppress(DriverError):
        bus.disable_torque()
    bus.close()


@pytest.fixture
def link(servo_site: ServoSite) -> Iterator[ServoLink]:
    """The servos' registers, configured, torque off before and after."""
    settings = servo_site.settings
    link = ServoLink(settings.port, settings.baud_rate, settings.reply_margin)
    link.open()
    try:
        set_up(link, settings)
        yield link
        for servo in settings.ids:
            with contextlib.suppress(DriverError):
                link.write(servo, "torque_enable", 0)
    finally:
        link.close()


@pytest.fixture
def host(board_site: BoardSite) -> Iterator[BoardHost]:
    """The connected board: contactor open, no fault, no stream, default rate, before and after."""
    host = BoardHost(board_site.path)
    host.link.open()
    try:
        host.settle()
        yield host
        with contextlib.suppress(DriverError):
            host.settle()
    finally:
        host.link.close()
