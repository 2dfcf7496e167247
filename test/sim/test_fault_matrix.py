# SPDX-License-Identifier: Apache-2.0
"""Every fault of the hardware on the wires of real nodes: its effects and its recovery while it charges.

One charger serves all cells: after each fault it returns to its work, and no node is restarted.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest

from deltacharger_docking.codes import Code, State
from deltacharger_driver.emulators import power
from deltacharger_sim.charger.faults import Fault

from ..marks import night, rest
from ..waiting import host, wait_until
from .fault_table import INPUTS, NEVER, ROWS, Row

if TYPE_CHECKING:
    from .fault_bench import Bench, FaultClient, Mark

pytestmark = pytest.mark.ros

_GOES_ON = 0.6  # s of the world for which work continues under a tolerated fault
_PUSHES_MORE = 5.0  # N of additional push that is permitted; a stop must never press harder
_SLACK = 0.1  # s: an opening's ramp (0.05), the power stage's cycle and the world's step
_CYCLES = 20  # of the servo bus
_TRANSPORT = 0.1  # s, longest transport of a message

WITNESSES = ("servo_missing", "servo_overload", "board_silent")
"""One cell for each way in which a fault travels: lost bytes, a latched error, a silent board."""
CELLS = [
    pytest.param(row, id=row.name, marks=pytest.mark.witness if row.name in WITNESSES else pytest.mark.rest)
    for row in ROWS
]


@pytest.fixture(scope="module")
def benches(context: Any) -> Iterator[list[Bench]]:
    benches: list[Bench] = []
    with pytest.MonkeyPatch.context() as patch:
        # The emulated board's clock is this computer's, which may be busy.
        patch.setattr(power, "HEARTBEAT_LIMIT", host(power.HEARTBEAT_LIMIT))
        yield benches
        for bench in benches:
            bench.close()


@pytest.fixture
def bench(context: Any, benches: list[Bench]) -> Iterator[Bench]:
    """The charger of all cells; after a failed cell there is a new one."""
    from ..chargers import new_namespace
    from .fault_bench import Bench

    if not benches:
        benches.append(Bench(context, new_namespace()))
    bench = benches.pop()
    yield bench
    (benches.append if bench.is_well else Bench.close)(bench)  # type: ignore[arg-type, operator]


@pytest.mark.parametrize("row", CELLS)
def test_fault(bench: Bench, row: Row) -> None:
    """Cause a fault, end it and recover; everything in its row holds."""
    bench.is_well = False
    bench.charge()
    before = int(bench.client.value(row.part, row.counted))
    mark = bench.mark()
    bench.faults.begin(Fault(kind=row.kind, servo=row.servo, amount=row.amount))
    try:
        wait_for_effects(bench, row, mark, before)
        check_order(bench, row, mark)
    except AssertionError as error:
        events = [event._replace(time=event.time - mark.world) for event in bench.world.events[mark.events :]]
        told = dict.fromkeys(f"{each.name}: {each.message}" for each in bench.client.told("", mark.host))
        raise AssertionError(f"{error}\nevents {events}\n{list(told)}") from error
    finally:
        bench.faults.clear()
    recover(bench, row, mark)
    bench.charge()
    assert bench.client.untrue == []
    bench.is_well = True


def wait_for_effects(bench: Bench, row: Row, mark: Mark, before: int) -> None:
    world, client = bench.world, bench.client
    if row.opens != NEVER:
        bench.wait(lambda: not world.circuit.closed, "the contactor to open")
    if row.torque_off:
        reached = [servo for servo in (1, 2, 3) if servo not in row.deaf]
        bench.wait(lambda: not any(world.torque[servo - 1] for servo in reached), "the torque to go off")
        if row.deaf:
            since, released = time.monotonic(), ("torque off", "disconnected")
            bench.wait(
                lambda: client.value("servo bus", "state", since) in released, "servo_node to release all servos"
            )
    if row.warning:
        # The reason for a loss of torque must remain visible for later readers, not only during it.
        since = time.monotonic() + _TRANSPORT if row.torque_off else mark.host
        told = functools.partial(client.has_warned, row.part, row.warning, since)
        bench.wait(told, f"{row.part} to report {row.warning}")
    if row.counted:
        bench.wait(lambda: int(client.value(row.part, row.counted)) > before, f"{row.part} to count {row.counted}")
    for what in row.unknown:
        if what in ("frames", "power"):
            wait_for_silence(client, str(what).removesuffix("s"))
        else:
            bench.wait(functools.partial(was_unknown, client, what, mark.host), f"{what} to be unknown")
    if not row.torque_off:
        bench.wait(lambda: world.time > mark.world + _GOES_ON, "the world to go on")


def was_unknown(client: FaultClient, what: int | str, since: float) -> bool:
    """Whether a servo (its id) was reported as NaN since then, or "taxel N" is NaN."""
    if isinstance(what, str):
        return math.isnan(client.taxels()[int(what.removeprefix("taxel "))])
    return client.unknown_at.get(what, 0.0) > since


def wait_for_silence(client: FaultClient, topic: str) -> None:
    """Wait until a topic has been silent for half a second: unknown frames are not published."""
    count, since = client.received[topic], time.monotonic()

    def is_silent() -> bool:
        nonlocal count, since
        if client.received[topic] != count:
            count, since = client.received[topic], time.monotonic()
        return time.monotonic() > since + 0.5

    wait_until(is_silent, f"the end of {topic}", 10.0)


def check_order(bench: Bench, row: Row, mark: Mark) -> None:
    """The contactor opens in time and before torque is lost, nothing returns by itself, and nothing presses harder."""
    from .fault_world import CONTACTOR

    world = bench.world
    opened = world.since(mark.events, CONTACTOR, False)
    if row.opens != NEVER:
        assert opened[0].time - mark.world <= host(row.opens) + _SLACK
        assert not world.circuit.closed
        assert world.since(mark.events, CONTACTOR, True) == [], "it closed again without a probe"
    else:
        assert bench.is_charging(), "charging did not go on"
        assert opened == []
    for servo in (1, 2, 3):
        released = world.since(mark.events, servo, False)
        live = [event for event in released if event.live]
        if servo in row.at_once:
            assert all(event.time <= mark.world + _SLACK for event in live), live
        else:
            assert live == [], f"servo {servo} lost torque with live electrodes"
        assert row.torque_off or released == [], f"servo {servo} lost torque"
        assert world.since(mark.events, servo, True) == [], f"the torque of servo {servo} returned by itself"
    harder = world.record.peak_push - mark.push
    assert harder <= _PUSHES_MORE, f"the servos pushed {harder:.1f} N harder than before"
    assert world.record.energised_shorts == 0


def recover(bench: Bench, row: Row, mark: Mark) -> None:
    """Perform the row's recovery and check that it is needed; until then torque stays off and the contactor open."""
    client, world = bench.client, bench.world
    if row.opens != NEVER:
        client.stop_renewing()
    if row.torque_off:
        bench.wait(lambda: all(client.servo.valid), "all servos to answer again")
        bench.wait(lambda: not any(world.torque), "the torque off everywhere")
    for step in row.recovery:
        if step == "reboot_servos":
            refused = client.call("set_torque", data=True)
            assert not refused.success
            assert "reboot_servos" in refused.message
            bench.ask("reboot_servos")
            assert not any(world.torque), "a reboot switched torque on"
        elif step == "tare":
            bench.wait(lambda: not client.frame.tared, "frames that say that they are not tared")
            bench.tare()
        elif step == "open":
            bench.wait(lambda: client.power.fault, "the latched fault on charger_power")
            bench.ask("set_contactor", close=False)
            bench.wait(lambda: not client.power.fault, "the fault cleared")
    if row.torque_off:  # a program that would switch it on has had time for it
        count = client.received["servo"]
        bench.wait(lambda: client.received["servo"] >= count + _CYCLES, "servo_state to go on")
        on = [event for servo in (1, 2, 3) for event in world.since(mark.events, servo, True)]
        assert on == [], "torque returned before a request"


@pytest.fixture(scope="module")
def charger(context: Any) -> Iterator[Any]:
    from deltacharger_scenes.scene import parse_scene

    from ..running_charger import QUICK, RunningCharger

    with RunningCharger(parse_scene(QUICK, "faults"), context) as charger:
        yield charger


KINDS = ("servo_missing", "servo_overload", "servo_unplugged", "servo_watchdog", "board_reboot", "board_unplugged")


@pytest.mark.parametrize(
    "row", [rest(row) if row.kind == KINDS[1] else night(row) for row in ROWS if row.kind in KINDS]
)
def test_a_docked_charger_under_a_fault(charger: Any, row: Row) -> None:
    """Charging ends with the code of what docking sees, and the next goal shows recovery."""
    from deltacharger.msg import DockingState
    from std_srvs.srv import Trigger

    from deltacharger_ros.messages import CODES

    from ..nodes import call

    code = INPUTS[row.shows].codes[State.CHARGING] if row.shows else Code.NONE
    record, lost = charger.world.record, charger.world.record.unpowered_live
    charger.charge()
    charger.emulators.faults.begin(Fault(kind=row.kind, amount=row.amount))
    if code is Code.NONE:
        assert charger.undock().success
    else:
        wait_until(lambda: charger.state.error_code, "an error")
        wait_until(lambda: charger.state.state == DockingState.STATE_IDLE, "the arm back")
        assert CODES[charger.state.error_code] == code.name
    charger.emulators.faults.clear()
    if "reboot_servos" in row.recovery:
        reboot = charger.client.node.create_client(Trigger, "reboot_servos")
        wait_until(lambda: call(reboot, Trigger.Request()).success, "the reboot of the servos")
        charger.client.node.destroy_client(reboot)
    charger.wait_until_ready()
    assert not charger.is_closed
    # A servo loses its torque at once: no driver can open before that.
    assert record.unpowered_live - lost <= bool(row.at_once)
    assert (record.energised_shorts, record.energised_unsafe, record.parted_live) == (0, 0.0, 0)
