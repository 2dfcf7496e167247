# SPDX-License-Identifier: Apache-2.0
"""Requests to the charger and their progress and results, as plain data without ROS types."""

import math
from dataclasses import asdict, dataclass, field
from typing import Any

from deltacharger_core import frames, texts


def place(x: float, y: float, z: float, roll: float) -> str:
    """Return a position (m) and roll (rad) of electrodes as text."""
    return f"({1e3 * x:.1f}, {1e3 * y:.1f}, {1e3 * z:.1f}) mm, roll {math.degrees(roll):.1f}°"


@dataclass(frozen=True)
class Pose:
    """Midpoint of the target's electrodes: position (m) and roll about z (rad) in the frame `frame_id`.

    charger_base means the frame of the addressed charger, also if it has a prefix.
    """

    x: float
    y: float
    z: float
    roll: float = 0.0
    frame_id: str = frames.CHARGER_BASE


@dataclass(frozen=True)
class DockRequest:
    """A Dock goal.

    Attributes:
        electrodes: pose of the target's electrodes; None = use the camera.
        critical_angle: rad; 0 = the charger's value, which is also the maximum.
        start_charging: False = end when the electrodes rest with clearance.
        hold: keep the goal active until a stop condition, a full target or a cancel.
        stop_energy: J to deliver, 0 = no limit.
        stop_after: s of charging, 0 = no limit.
        request_id: returned in docking_state.
        target_profile: name of the target's profile; '' = the charger's first one.
    """

    electrodes: Pose | None = None
    critical_angle: float = 0.0
    start_charging: bool = True
    hold: bool = False
    stop_energy: float = 0.0
    stop_after: float = 0.0
    request_id: str = ""
    target_profile: str = ""


@dataclass(frozen=True)
class Progress:
    """One feedback message of an action.

    Attributes:
        time: s since the goal was sent.
        phase: name of the state, lower case.
        z: m, measured, charger_base; NaN = not measured.
        contact_current: A per servo; NaN = not measured.
        charge_current: A into the target; NaN = not measured or not reported.
        alignments: lateral corrections so far.
        horizontal: m, vertical: m, angle: rad, the last estimate; NaN = none yet.
        waiting_for: what the charger waits for now; '' = nothing.
    """

    time: float
    phase: str
    z: float = math.nan
    contact_current: float = math.nan
    charge_current: float = math.nan
    alignments: int = 0
    horizontal: float = math.nan
    vertical: float = math.nan
    angle: float = math.nan
    waiting_for: str = ""


@dataclass(frozen=True)
class Outcome:
    """How an action ended.

    Attributes:
        action: "dock", "undock" or "charge_robot".
        success: whether the goal was reached.
        error_code: 0 or a code of Dock.Result; error_name: its name.
        error_message: what failed and what to do; after a success a notice about its limits ('' = none).
        retriable: the same goal may succeed if sent again.
        elapsed: s that the charger worked on it.
        details: the result's other fields by name, SI units, NaN = not measured.
    """

    action: str
    success: bool
    error_code: int
    error_name: str
    error_message: str
    retriable: bool
    elapsed: float
    details: dict[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return one flat, JSON-ready mapping; NaN and infinity become None."""
        plain = asdict(self)
        details = plain.pop("details")
        flat: dict[str, Any] = json_ready({**plain, **details})
        return flat

    def ending(self, failed: str = "failed") -> str:
        """Return the end as text; `failed`: word for an end without success."""
        if self.success:
            notice = f"; {self.error_message}" if self.error_message else ""
            return f"done in {self.elapsed:.1f} s{notice}"
        retry = "; the same goal may succeed if sent again" if self.retriable else ""
        return f"{failed}, {self.error_code} {self.error_name}: {self.error_message}{retry}"

    @property
    def lost_the_charge(self) -> bool:
        """Whether the failure itself ended charging, without its client's wish."""
        return self.details.get("charge_end") == self.error_name != "CANCELED"

    def figures(self) -> str:
        """Return the figures of a docking, or of a mission's last one, as text; '' for undock; – = not measured."""
        details = self.details
        if not details:
            return ""
        rest = details["misalignment"]
        x, y = (texts.figure(1e3 * rest[axis], "", 1) for axis in ("horizontal", "vertical"))
        angle = texts.figure(math.degrees(rest["angle"]), "", 1)
        least, most = (texts.figure(details.get(f"contact_force_{end}", math.nan), "", 0) for end in ("min", "max"))
        span = "" if "–" in (least, most) else f" ({least} to {most})"
        end, volts = details.get("charge_end", ""), details.get("charge_voltage", math.nan)
        end = f", {end}" if end else ""
        end += f" at {volts:.1f} V" if math.isfinite(volts) else ""
        counts = ", ".join(f"{name} {details[name]}" for name in ("alignments", "redockings") if name in details)
        return (
            f"charge {texts.figure(details['charge_current'], 'A', 2)}, "
            f"{texts.figure(details['energy'], 'J', 0)}{end}; "
            f"contact {texts.figure(details['contact_current'], 'A', 3)}, "
            f"{texts.figure(details['contact_force'], 'N', 1)}{span}; "
            f"{counts}; rest ({x}, {y}) mm, {angle}°"
        )


def json_ready(value: Any) -> Any:
    """Return `value` with every NaN and infinity replaced by None, for JSON."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(key): json_ready(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_ready(item) for item in value]
    return value
