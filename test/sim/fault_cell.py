# SPDX-License-Identifier: Apache-2.0
"""One cell of the fault matrix: a fault during work, its effects, its recovery."""

from __future__ import annotations

import functools
import math
import time

from deltacharger_sim.charger.faults import Fault

from .fault_bench import PATIENCE, Bench, Mark, Phase, contactor_opened
from .fault_client import FaultClient
from .fault_table import NEVER, Row
from .fault_world import CONTACTOR

_GOES_ON = 0.6  # s of the world for which work continues under a tolerated fault
_STANDS = 0.35  # s for which one servo may stop while the others continue
_PUSHES_MORE = 5.0  # N of additional push that is permitted; a stop must never press harder
_SLACK = 0.1  # s: an opening's ramp (0.05), the power stage's cycle and the world's step
_CYCLES = 20  # of the servo bus
_TRANSPORT = 0.1  # s, longest transport of a message
_DIAGNOSTICS = 4.0  # s; diagnostics are published once a second


def check_fault(bench: Bench, row: Row, phase: Phase) -> None:
    """Cause a fault, end it and recover; assert everything in its row.

    Repeats a failed cell if the computer was too busy.
    """
    bench.pulse.attempt(lambda: _check_fault(bench, row.at(phase), phase), bench.restore)


def _check_fault(bench: Bench, row: Row, phase: Phase) -> None:
    bench.reach(phase)
    before = bench.client.count(row.part, row.counted)
    mark = bench.mark()
    bench.faults.begin(Fault(kind=row.kind, servo=row.servo, amount=row.amount))
    try:
        _wait_for_effects(bench, row, phase, mark, before)
        _check_order(bench, row, phase, mark)
    except AssertionError as error:
        diagnostics = "\n".join(bench.client.messages(mark.host))
        events = [event._replace(time=event.time - mark.world) for event in bench.world.events[mark.events :]]
        raise AssertionError(f"{error}\nevents {events}\ndiagnostics:\n{diagnostics}") from error
    finally:
        bench.faults.clear()
    _recover(bench, row, mark)
    bench.reach(phase)
    assert bench.client.untrue == []


def _wait_for_effects(bench: Bench, row: Row, phase: Phase, mark: Mark, before: int) -> None:
    world, client = bench.world, bench.client
    if phase is Phase.CHARGING and row.opens != NEVER:
        bench.wait(lambda: not world.circuit.closed, "the contactor to open")
    if row.torque_off:
        reached = [servo for servo in (1, 2, 3) if servo not in row.deaf]
        bench.wait(lambda: not any(world.torque[servo - 1] for servo in reached), "the torque to go off")
        if row.deaf:
            since = time.monotonic()
            bench.wait(lambda: client.has_released_servos(since), "servo_node to have released all servos")
    if row.warning:
        # The reason for a loss of torque must remain visible for later readers, not only during it.
        since = time.monotonic() + _TRANSPORT if row.torque_off else mark.host
        bench.wait(
            lambda: client.has_warned(row.part, row.warning, since), f"{row.part} to report {row.warning}", _DIAGNOSTICS
        )
    if row.counted:
        bench.wait(lambda: client.count(row.part, row.counted) > before, f"{row.part} to count {row.counted}")
    if row.asked:
        name, *words = row.asked
        answer = client.call(name)
        assert not answer.success
        assert all(word in answer.message for word in words), answer.message
    for what in row.unknown:
        if what in ("frames", "power"):
            _wait_for_silence(client, str(what).removesuffix("s"))
        else:
            bench.wait(functools.partial(_was_unknown, client, what, mark.host), f"{what} to be unknown")
    if not row.torque_off:
        bench.wait(lambda: world.time > mark.world + _GOES_ON, "the world to go on")


def _was_unknown(client: FaultClient, what: int | str, since: float) -> bool:
    """Whether a servo (its id) was reported as NaN since then, or "taxel N" is NaN."""
    if isinstance(what, str):
        return math.isnan(client.taxels()[int(what.removeprefix("taxel "))])
    return client.unknown_at.get(what, 0.0) > since


def _wait_for_silence(client: FaultClient, topic: str) -> None:
    """Wait until a topic has been silent for half a second: unknown frames are not published."""
    count, since = client.received[topic], time.monotonic()
    end = since + PATIENCE
    while time.monotonic() < since + 0.5:
        if client.received[topic] != count:
            count, since = client.received[topic], time.monotonic()
        assert time.monotonic() < end, f"{topic} goes on"
        time.sleep(0.01)


def _check_order(bench: Bench, row: Row, phase: Phase, mark: Mark) -> None:
    """The contactor opens in time and before torque is lost, nothing returns by itself, and nothing presses harder."""
    world = bench.world
    if phase is Phase.CHARGING and row.opens != NEVER:
        opened, starved = contactor_opened(bench, mark), bench.pulse.starved(mark.host)
        assert opened <= row.opens + _SLACK + starved, f"open after {opened:.3f} s ({starved:.3f} s starved)"
        assert not world.circuit.closed
        assert world.since(mark.events, CONTACTOR, True) == [], "it closed again without a probe"
    elif phase is Phase.CHARGING:
        assert bench.is_charging(), "charging did not go on"
        assert world.since(mark.events, CONTACTOR, False) == []
    for servo in (1, 2, 3):
        released = world.since(mark.events, servo, False)
        live = [event for event in released if event.live]
        if servo in row.at_once:
            assert all(event.time <= mark.world + _SLACK for event in live), live
        else:
            assert live == [], f"servo {servo} lost torque with live electrodes"
        if not row.torque_off:
            assert released == [], f"servo {servo} lost torque"
        assert world.since(mark.events, servo, True) == [], f"the torque of servo {servo} returned by itself"
    if phase is Phase.MOVING and not row.torque_off:
        now = world.time
        bench.wait(lambda: bench.is_moving(now), "the motion to go on")
        assert world.stood <= _STANDS + bench.pulse.starved(mark.host), f"a servo stood still for {world.stood:.2f} s"
    if phase is not Phase.MOVING:
        harder = world.record.peak_push - mark.push
        assert harder <= _PUSHES_MORE, f"the servos pushed {harder:.1f} N harder than before"
    assert world.record.energised_shorts == 0


def _recover(bench: Bench, row: Row, mark: Mark) -> None:
    """Perform the row's recovery and check that it is needed; until then torque stays off and the contactor open."""
    client, world = bench.client, bench.world
    if row.opens != NEVER:
        client.stop_renewing()
    if row.torque_off:
        bench.wait(lambda: all(client.servo.valid), "all servos to answer again")
        bench.wait(lambda: not any(world.torque), "the torque off everywhere", _DIAGNOSTICS)
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
    if row.torque_off:
        assert on == [], "torque returned before a request"
