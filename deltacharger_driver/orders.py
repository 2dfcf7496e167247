# SPDX-License-Identifier: Apache-2.0
"""The age of orders: one that waited too long, as for a suspended node, would fall into another goal. No ROS."""

from __future__ import annotations

from deltacharger_core.host_clock import COMPARE_CLOCKS
from deltacharger_core.machine import ORDER_AGE_MAX


def late(age: float) -> str:
    """Return why an order of this age (s) is not carried out; '' = it is."""
    if age <= ORDER_AGE_MAX:
        return ""
    return (
        f"the order was sent {age:.1f} s ago, more than {ORDER_AGE_MAX:g} s, and is not carried out: if it is still "
        f"wanted, give it again; check whether this computer is too busy; {COMPARE_CLOCKS}"
    )
