# SPDX-License-Identifier: Apache-2.0
"""The runtime of scripts of docking and mission: a script is closed on every way out, the first reply counts."""

from dataclasses import dataclass

from deltacharger_core.script import NEXT, Calls, Runner, Script


@dataclass(frozen=True)
class Reply:
    number: int
    text: str = ""


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
    assert calls.take_reply(asked) == Reply(asked, "first")
    assert calls.take_reply(asked) is None
    assert calls.take_reply(unawaited) is None
    assert calls.take_reply(99) is None
