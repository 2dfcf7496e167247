# SPDX-License-Identifier: Apache-2.0
"""Print the progress and the result of an action, as text or as JSON."""

from __future__ import annotations

import math
from typing import Any

from deltacharger_bringup.cli.output import log_line, print_text, write_json
from deltacharger_core.quantity import figure
from deltacharger_ros.outcomes import Outcome, Progress


def report(outcome: Outcome, as_json: bool, more: dict[str, Any]) -> None:
    """Print the result of an action, as text or as the JSON object."""
    if as_json:
        write_json({**outcome.as_dict(), **more})
        return
    print_text(f"{outcome.action}: {outcome.ending()}")
    suggested = None if outcome.success else outcome.details.get("suggested_base_pose")
    if suggested:
        place = ", ".join(f"{1e3 * value:.1f}" for value in suggested["position"])
        turn = f", turned by {math.degrees(suggested['yaw']):+.1f}° about its y" if suggested["yaw"] else ""
        print_text(f"  possible with charger_base at ({place}) mm of {suggested['frame_id']}{turn}")


class PhasePrinter:
    """Print one line when a phase begins, and store the phases.

    Args:
        force: returns the present contact force (N, NaN = unknown).

    Attributes:
        phases: one mapping per phase: phase, start (s), z (m), contact_current (A), force (N), alignments.
    """

    def __init__(self, force: Any = None) -> None:
        self._force = force
        self.phases: list[dict[str, Any]] = []

    def __call__(self, progress: Progress) -> None:
        """Handle one feedback message."""
        if self.phases and self.phases[-1]["phase"] == progress.phase:
            return
        force = float("nan") if self._force is None else self._force()
        self.phases.append(
            {
                "phase": progress.phase,
                "start": progress.time,
                "z": progress.z,
                "contact_current": progress.contact_current,
                "force": force,
                "alignments": progress.alignments,
            }
        )
        columns = [f"{progress.time:7.2f} s", f"{progress.phase:<9}", f"z {figure(1e3 * progress.z, 'mm', 1, 7)}"]
        if progress.charge_current == progress.charge_current:
            columns.append(f"charge {figure(progress.charge_current, 'A', 2, 7)}")
        else:
            columns.append(f"I_c {figure(progress.contact_current, 'A', 3, 7)}")
        if self._force is not None:
            columns.append(f"force {figure(force, 'N', 1, 7)}")
        if progress.waiting_for:
            columns.append(f"waits for {progress.waiting_for}")
        log_line("  ".join(columns))
