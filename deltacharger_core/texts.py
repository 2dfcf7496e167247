# SPDX-License-Identifier: Apache-2.0
"""Bounds and formats of texts received from other programs."""

from __future__ import annotations

REQUEST_ID_MAX = 256
"""Maximum characters of a goal's request_id, which states, decisions, logs, records and file names repeat."""
MESSAGE_MAX = 1000
"""Maximum characters of another node's message that are repeated."""


def cut(text: str, most: int = MESSAGE_MAX) -> str:
    """Return a text; a longer one is cut and its length stated."""
    return text if len(text) <= most else f"{text[:most]}… ({len(text)} characters)"


def wrong_id(request_id: str) -> str:
    """Return the error in a goal's request_id; '' = none."""
    if len(request_id) <= REQUEST_ID_MAX:
        return ""
    return f"request_id has {len(request_id)} characters: give at most {REQUEST_ID_MAX}"


def titled(action: str, request_id: str) -> str:
    """Return a goal's name for logs: action and request_id, if any."""
    return f"{action} {request_id}" if request_id else action


def passage(title: str, before: str, after: str, lasted: float, *more: str) -> str:
    """Return a log line for the change of a goal's phase; `lasted`: s in the phase before (NaN = omitted)."""
    after = f"{after.lower()} after {lasted:.1f} s" if lasted == lasted else after.lower()
    return ", ".join((f"{title}: {before.lower()} → {after}", *more))
