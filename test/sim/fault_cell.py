# SPDX-License-Identifier: Apache-2.0
"""One cell of the fault matrix: a fault comes while the charger works, its effect is read off, and work goes on."""

from __future__ import annotations

import functools
import math
import time

from deltacharger_sim.charger.faults import Fault

from .fault_bench import PATIENCE, Bench, Mark, Phase, contactor_opened
from .fault_client import FaultClient
from .fault_table import NEVER, Row
from .fault_world import CONTACTOR

_GOES_ON = 0.6  # s of the world for which work goes on under a fault that is borne
_STANDS = 0.35  # s for which one servo may stand still while the others go on
_PUSHES_MORE = 5.0  # N that the servos may push more than before; a stop must never press harder
_SLACK = 0.1  # s: an opening's ramp (0.05), the power stage's turn and the world's step
_CYCLES = 20  # of the servo bus
_UNDER_WAY = 0.1  # s that a message may take
_TELLING = 4.0  # s; diagnostics come once a second


def suffer(bench: Bench, row: Row, phase: Phase) -> None:
    """Let a fault come, end, and be recovered from; assert everything that its row says.

    Begins again where it failed on a machine that was seen to be too busy.
    """
    bench.pulse.attempt(lambda: _suffer(bench, row.at(phase), phase), bench.restore)


def _suffer(bench: Bench, row: Row, phase: Phase) -> None:
    bench.reach(phase)
    before = bench.client.count(row.part, row.counted)
    mark = bench.mark()
    bench.faults.begin(Fault(kind=row.kind, servo=row.servo, amount=row.amount))
    try:
        _wait_for_effects(bench, row, phase, mark, before)
        _check_order(bench, row, phase, mark)
    except AssertionError as error:
        told = "\n".join(bench.client.messages(mark.host))
        events = [event._replace(time=event.time - mark.world) for event in bench.world.events[mark.events :]]
        raise AssertionError(f"{error}\nevents {events}\ntold:\n{told}") from error
    finally:
        bench.faults.clear()
    _recover(bench, row, mark)
    bench.reach(phase)
    assert bench.client.untrue == []


def _wait_for_effects(bench: Bench, row: Row, phase: Phase, mark: Mark, before: int) -> None:
    world, client = bench.world, bench.client
    if phase is Phase.CHARGING and row.opens != NEVER:
        bench.wait(lambda: not world.circuit.closed, "the contactor to open")
    if row.lets_go:
        reached = [servo for servo in (1, 2, 3) if servo not in row.deaf]
        bench.wait(lambda: not any(world.torque[servo - 1] for servo in reached), "the torque to go off")
        if row.deaf:
            since = time.monotonic()
            bench.wait(lambda: client.has_let_go(since), "servo_node to have told all servos to let go")
    if row.says:
        # Where torque went, why it did must stand there for whoever looks later, not only while it was going.
        since = time.monotonic() + _UNDER_WAY if row.lets_go else mark.host
        bench.wait(lambda: client.told(row.part, row.says, since), f"{row.part} to tell of {row.says}", _TELLING)
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
    if not row.lets_go:
        bench.wait(lambda: world.time > mark.world + _GOES_ON, "the world to go on")


def _was_unknown(client: FaultClient, what: int | str, since: float) -> bool:
    """Whether a servo (its id) was told as NaN since then, or "taxel N" is."""
    if isinstance(what, str):
        return math.isnan(client.taxels()[int(what.removeprefix("taxel "))])
    return client.unknown_at.get(what, 0.0) > since


def _wait_for_silence(client: FaultClient, topic: str) -> None:
    """Wait until a topic has said nothing for half a second: silence is how an unknown frame is told."""
    heard, since = client.heard[topic], time.monotonic()
    end = since + PATIENCE
    while time.monotonic() < since + 0.5:
        if client.heard[topic] != heard:
            heard, since = client.heard[topic], time.monotonic()
        assert time.monotonic() < end, f"{topic} goes on"
        time.sleep(0.01)


def _check_order(bench: Bench, row: Row, phase: Phase, mark: Mark) -> None:
    """The contactor opens in time and before torque goes, nothing comes back by itself, and nothing presses harder."""
    world = bench.world
    if phase is Phase.CHARGING and row.opens != NEVER:
        opened, starved = contactor_opened(bench, mark), bench.pulse.starved(mark.host)
        assert opened <= row.opens + _SLACK + starved, f"open after {opened:.3f} s ({starved:.3f} s starved)"
        assert not world.circuit.closed
        assert world.since(mark.events, CONTACTOR, True) == [], "it closed again without anybody's probe"
    elif phase is Phase.CHARGING:
        assert bench.is_charging(), "charging did not go on"
        assert world.since(mark.events, CONTACTOR, False) == []
    for servo in (1, 2, 3):
        let_go = world.since(mark.events, servo, False)
        live = [event for event in let_go if event.live]
        if servo in row.at_once:
            assert all(event.time <= mark.world + _SLACK for event in live), live
        else:
            assert live == [], f"servo {servo} let go of live electrodes"
        if not row.lets_go:
            assert let_go == [], f"servo {servo} let go"
        assert world.since(mark.events, servo, True) == [], f"the torque of servo {servo} came back by itself"
    if phase is Phase.MOVING and not row.lets_go:
        now = world.time
        bench.wait(lambda: bench.is_moving(now), "the motion to go on")
        assert world.stood <= _STANDS + bench.pulse.starved(mark.host), f"a servo stood still for {world.stood:.2f} s"
    if phase is not Phase.MOVING:
        harder = world.record.peak_push - mark.push
        assert harder <= _PUSHES_MORE, f"the servos pushed {harder:.1f} N harder than before"
    assert world.record.energised_shorts == 0


def _recover(bench: Bench, row: Row, mark: Mark) -> None:
    """Do what the row says and see that it is needed; torque stays off and the contactor open until somebody asks."""
    client, world = bench.client, bench.world
    if row.opens != NEVER:
        client.let_open()
    if row.lets_go:
        bench.wait(lambda: all(client.servo.valid), "all servos to answer again")
        bench.wait(lambda: not any(world.torque), "the torque off everywhere", _TELLING)
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
    if row.lets_go:  # whoever would switch it on again has had time to
        heard = client.heard["servo"]
        bench.wait(lambda: client.heard["servo"] >= heard + _CYCLES, "servo_state to go on")
    on = [event for servo in (1, 2, 3) for event in world.since(mark.events, servo, True)]
    if row.lets_go:
        assert on == [], "torque came back before anybody asked"
