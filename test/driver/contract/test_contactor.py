# SPDX-License-Identifier: Apache-2.0
"""Laws of a healthy board's contactor with a battery connected. On a real one only with --close-contactor."""

import time
from collections.abc import Iterator

import pytest

from deltacharger_core.machine import PROBE_LIFETIME, ChargeLimits
from deltacharger_driver.board import protocol

from ...chargers import patience
from ...waiting import host as within, wait_until
from .host import BoardHost
from .sites import BoardSite

pytestmark = pytest.mark.usefixtures("may_close")

LIMITS = ChargeLimits(1.0, 29.4)
LONGEST_CLOSE = 5.0  # s; whatever a test does, its heartbeat stops then
SEEN_WITHIN = (
    protocol.HEARTBEAT_TIMEOUT + 2.0 / protocol.POWER_RATE
)  # s from the last heartbeat to a POWER packet that reports open


@pytest.fixture
def loaded(host: BoardHost, board_site: BoardSite) -> Iterator[BoardHost]:
    """A board whose electrodes touch a battery; an emulated one waits for this computer's heartbeat thread."""
    board_site.connect_load()
    result = host.link.probe()
    problem = protocol.probe_problem(result.resistance, result.target_voltage)
    assert not problem, f"--close-contactor needs a battery between the electrodes: {problem}"
    host.link.contactor(False)
    with patience():
        yield host


def close(host: BoardHost) -> None:
    """Probe and close, as a client must."""
    host.link.contactor(False)
    host.link.probe()
    host.link.keep_alive(time.monotonic() + LONGEST_CLOSE)
    host.link.contactor(True, LIMITS)
    host.await_contactor(closed=True)


def refused(host: BoardHost) -> int:
    """Request a close that must be refused, and return the board's reason."""
    with pytest.raises(protocol.CommandRefused) as refusal:
        host.link.contactor(True, LIMITS)
    return refusal.value.error


def stays_open(host: BoardHost) -> bool:
    return not any(sample.power.contactor_closed for sample in host.next_powers(4))


def test_no_close_without_a_heartbeat(loaded: BoardHost) -> None:
    loaded.link.probe()
    assert refused(loaded) == protocol.AckError.INTERLOCK
    assert stays_open(loaded)


def test_no_close_without_a_probe_since_the_last_opening(loaded: BoardHost) -> None:
    loaded.link.probe()
    loaded.link.contactor(False)
    loaded.link.keep_alive(time.monotonic() + LONGEST_CLOSE)
    assert refused(loaded) == protocol.AckError.INTERLOCK
    assert stays_open(loaded)


@pytest.mark.rest
def test_no_close_after_the_probe_is_too_old(loaded: BoardHost) -> None:
    result = loaded.link.probe()
    loaded.link.keep_alive(time.monotonic() + LONGEST_CLOSE)
    wait_until(lambda: time.monotonic() > result.time + PROBE_LIFETIME, "the probe to become too old")
    assert refused(loaded) == protocol.AckError.INTERLOCK
    assert stays_open(loaded)


def test_a_closed_contactor_is_reported_and_an_open_one_needs_a_new_probe(loaded: BoardHost) -> None:
    close(loaded)
    for power in (sample.power for sample in loaded.next_powers(4)):
        assert power.contactor_closed
        assert power.fault == protocol.BoardFault.NONE
        assert abs(power.charge_current) < 20.0  # and it was measured
    assert refused(loaded) == protocol.AckError.NOT_NOW
    with pytest.raises(protocol.CommandRefused) as refusal:
        loaded.link.clear_weld()
    assert refusal.value.error == protocol.AckError.NOT_NOW
    with pytest.raises(protocol.CommandRefused) as refusal:
        loaded.link.probe()
    assert refusal.value.error == protocol.AckError.NOT_NOW
    loaded.link.contactor(False)
    opened = loaded.await_contactor(closed=False)
    assert opened.power.fault == protocol.BoardFault.NONE
    assert refused(loaded) == protocol.AckError.INTERLOCK
    assert stays_open(loaded)


def test_a_stopped_heartbeat_opens_the_contactor_in_time(loaded: BoardHost) -> None:
    close(loaded)
    assert all(sample.power.contactor_closed for sample in loaded.next_powers(4))
    loaded.link.stop_heartbeat()
    stopped = time.monotonic()
    opened = loaded.await_contactor(closed=False)
    assert opened.time - stopped < within(SEEN_WITHIN)
    assert opened.power.fault == protocol.BoardFault.HEARTBEAT_LOST
    assert refused(loaded) == protocol.AckError.INTERLOCK
    with pytest.raises(protocol.CommandRefused) as refusal:
        loaded.link.probe()
    assert refusal.value.error == protocol.AckError.INTERLOCK
    loaded.link.contactor(False)
    assert loaded.next_powers(2)[-1].power.fault == protocol.BoardFault.NONE, "an opening clears the latched fault"


def test_a_host_that_disconnects_leaves_the_contactor_open(loaded: BoardHost) -> None:
    close(loaded)
    loaded.link.close()
    time.sleep(within(SEEN_WITHIN))  # the silence itself
    loaded.powers.clear()
    loaded.link.open()
    assert stays_open(loaded)
