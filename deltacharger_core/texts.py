# SPDX-License-Identifier: Apache-2.0
"""Words that come from others, and how much of them is taken."""

from __future__ import annotations

REQUEST_ID_MAX = 256
"""Characters of a goal's request_id: it is repeated in states, decisions, logs, records and their names."""
MESSAGE_MAX = 1000
"""Characters of what another node says that are repeated."""


def cut(text: str, most: int = MESSAGE_MAX) -> str:
    """Return a text, or its beginning and how long it was."""
    return text if len(text) <= most else f"{text[:most]}… ({len(text)} characters)"


def wrong_id(request_id: str) -> str:
    """Return what is wrong with a goal's request_id; '' = nothing."""
    if len(request_id) <= REQUEST_ID_MAX:
        return ""
    return f"request_id has {len(request_id)} characters: give at most {REQUEST_ID_MAX}"


def titled(action: str, request_id: str) -> str:
    """Return what a goal is called in logs: its action, and its request_id where it has one."""
    return f"{action} {request_id}" if request_id else action


def passage(title: str, before: str, after: str, lasted: float, *more: str) -> str:
    """Return the line of a log that says which phase of a goal follows which, after how many s (NaN = never mind)."""
    after = f"{after.lower()} after {lasted:.1f} s" if lasted == lasted else after.lower()
    return ", ".join((f"{title}: {before.lower()} → {after}", *more))
