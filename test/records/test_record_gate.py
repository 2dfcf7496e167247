# SPDX-License-Identifier: Apache-2.0
"""A record keeps everything around an event, little from hours of charging, and never more than its limit."""

from __future__ import annotations

from random import Random

import pytest

from deltacharger_core.mcap_file import Raw
from deltacharger_docking.codes import State
from deltacharger_records.recording.gate import Gate
from deltacharger_records.recording.session import LOST_AFTER, TAIL, Seen, Session

BEFORE = 2.0
MANY = 10**9


def raw(topic: str, number: int, data: bytes = b"x" * 100) -> Raw:
    return Raw(topic, number, number, data)


def gate(rate: float = 1.0, budget: int = MANY) -> Gate:
    return Gate(BEFORE, rate, budget, ["state"])


def numbers(messages: list[Raw]) -> list[int]:
    return [message.received for message in messages]


def test_a_record_begins_with_the_seconds_before_and_keeps_everything_after() -> None:
    kept, tap = list[Raw](), gate()
    for number in range(1000):
        assert tap.offer(0.01 * number, raw("servo", number)) == []
    kept += tap.open()
    for number in range(1000, 1500):
        kept += tap.offer(0.01 * number, raw("servo", number))
    kept += tap.close()
    assert numbers(kept) == list(range(kept[0].received, 1500))
    assert 0.01 * (999 - kept[0].received) == pytest.approx(BEFORE, abs=0.02)


def test_messages_pass_in_order_and_every_state_passes() -> None:
    random = Random(1)
    for _ in range(30):
        tap, kept, states, now = gate(), list[Raw](), list[int](), 0.0
        tap.open()
        for number in range(80):
            now += random.uniform(0.0, 3.0)
            act, topic = random.choice(("", "rest", "wake", "stir")), random.choice(("state", "servo", "pads"))
            if act:
                getattr(tap, act)(*(() if act == "wake" else (now,)))
            kept += tap.offer(now, raw(topic, number))
            states += [number] if topic == "state" else []
        kept += tap.close()
        assert numbers(kept) == sorted(set(numbers(kept)))
        assert [message.received for message in kept if message.topic == "state"] == states
        assert len(kept) + tap.dropped.total() == 80


def charge(hours: float, budget: int = MANY) -> tuple[list[Raw], Gate]:
    """Charge for some hours at 5 messages a second, to keep the test fast; the gate assumes no rate."""
    tap, kept, message = gate(budget=budget), list[Raw](), raw("servo", 0)
    tap.open()
    tap.rest(0.0)
    for number in range(round(hours * 18_000)):
        kept += tap.offer(0.2 * number, message._replace(received=number))
    return kept, tap


def test_the_first_minutes_of_charging_are_kept_once_a_second_and_longer_charging_is_thinned() -> None:
    hour, two = (len(charge(hours)[0]) for hours in (1.0, 2.0))
    assert hour == pytest.approx(3600, rel=0.1)
    assert two - hour < 1.2 * 3600 * 0.7  # 3600 ln 2


def test_the_seconds_around_an_event_while_charging_are_complete() -> None:
    kept, tap = charge(0.1)
    now = 0.1 * 3600
    tap.stir(now)
    for number in range(1800, 1900):
        kept += tap.offer(0.2 * number, raw("servo", number))
    around = [number for number in numbers(kept) if abs(0.2 * number - now) < BEFORE - 0.2]
    assert around == list(range(around[0], around[-1] + 1))
    assert len(around) == pytest.approx(2 * (BEFORE - 0.2) / 0.2, abs=2)


def test_a_record_at_its_limit_keeps_only_the_states() -> None:
    tap, kept = gate(budget=10_000), list[Raw]()
    tap.open()
    for number in range(1000):
        kept += tap.offer(0.01 * number, raw("state" if number % 100 == 0 else "servo", number))
    assert sum(len(message.data) for message in kept) < 10_000 + 200 + 10 * 100
    assert sum(message.topic == "state" for message in kept) == 10
    assert tap.dropped["servo"] == 990 - sum(message.topic == "servo" for message in kept)


def seen(state: State, docked: bool = False, charging: bool = False) -> Seen:
    return Seen(int(state), docked, charging, 0, "", "r")


def test_a_session_lasts_from_the_first_motion_until_the_arm_is_home() -> None:
    session = Session()
    session.see(0.0, seen(State.IDLE))
    assert not session.begins(seen(State.IDLE))
    assert session.begins(seen(State.APPROACH))
    session.begin()
    for time, what in (
        (1.0, seen(State.APPROACH)),
        (2.0, seen(State.CHARGING, docked=True, charging=True)),
        (9.0, seen(State.IDLE, docked=True)),  # a stop condition: docked without current is not over
    ):
        session.see(time, what)
        assert not session.is_over(time + 100.0)
        assert not session.begins(what)
    session.see(20.0, seen(State.RETRACT))
    session.see(21.0, seen(State.IDLE))
    assert not session.is_over(21.0 + 0.9 * TAIL)
    assert session.is_over(21.0 + TAIL)
    assert session.begins(seen(State.APPROACH)), "the next docking does not wait for the tail of the last one"


def test_a_docking_ends_if_its_node_ends_but_not_if_the_node_returns() -> None:
    session = Session()
    session.begin()
    session.see(0.0, seen(State.CONTACT))
    session.note_publisher(1.0, alive=False)
    assert not session.is_over(1.0 + 0.9 * LOST_AFTER)
    session.note_publisher(2.0, alive=True)
    session.note_publisher(3.0, alive=False)
    assert not session.is_over(2.9 + LOST_AFTER)
    assert session.is_over(3.0 + LOST_AFTER)


def test_a_routine_decision_counts_as_an_event_once_per_state() -> None:
    session = Session()
    session.see(0.0, seen(State.CHARGING, docked=True))
    assert [session.is_news("blind"), session.is_news("blind"), session.is_news("unsafe")] == [True, False, True]
    session.see(1.0, seen(State.RETRACT))
    assert session.is_news("blind")
