# SPDX-License-Identifier: Apache-2.0
"""The runtime of docking's and the mission's scripts: waiting, errors thrown into them, and replies."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from deltacharger_core.script import NEXT, Calls, Runner, Script, Wait


@dataclass(frozen=True)
class Reply:
    number: int
    text: str = ""


def test_a_script_runs_step_by_step_and_reports_what_it_waits_for() -> None:
    done = []

    def script() -> Script[None]:
        yield Wait(3.0, reads=True)
        done.append("waited")
        yield NEXT

    runner = Runner()
    assert runner.step(None) == NEXT
    runner.start(script())
    assert runner.step(None) == Wait(3.0, reads=True)
    assert not done
    assert runner.step(None) == NEXT
    assert done == ["waited"]
    assert runner.is_running
    assert runner.step(None) == NEXT
    assert not runner.is_running


def test_a_problem_is_thrown_into_a_script_where_it_waits() -> None:
    def script() -> Script[None]:
        try:
            yield Wait(1e9)
        except TimeoutError:
            yield Wait(5.0)

    runner = Runner()
    runner.start(script())
    runner.step(None)
    assert runner.step(TimeoutError()) == Wait(5.0)
    with pytest.raises(KeyError):
        runner.step(KeyError())


def test_a_script_that_is_replaced_or_forgotten_is_closed() -> None:
    closed = []

    def script(name: str) -> Script[None]:
        try:
            yield NEXT
        finally:
            closed.append(name)

    runner = Runner()
    for name in ("first", "second"):
        runner.start(script(name))
        runner.step(None)
    assert closed == ["first"]
    runner.stop()
    assert closed == ["first", "second"]
    assert not runner.is_running


def test_only_the_first_reply_to_an_awaited_request_is_used() -> None:
    calls: Calls[Reply] = Calls()
    asked, unawaited = calls.number(), calls.number(awaited=False)
    calls.receive([Reply(unawaited), Reply(asked, "first"), Reply(asked, "second"), Reply(99)])
    assert calls.take(asked) == Reply(asked, "first")
    assert calls.take(asked) is None
    assert calls.take(unawaited) is None
    assert calls.take(99) is None
