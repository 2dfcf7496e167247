# SPDX-License-Identifier: Apache-2.0
"""What a person does about each way a docking can fail: the table of docs/errors.md, for whoever explains one."""

from __future__ import annotations

from deltacharger_docking.codes import Code

REMEDIES: dict[Code, str] = {
    Code.NONE: "",
    Code.REJECTED: "correct the goal, or wait for the running one",
    Code.CANCELED: "",
    Code.TIMEOUT: "see the phase in the message",
    Code.ELECTRODES_NOT_FOUND: "move the robot so that the camera sees the electrodes, or give coordinates",
    Code.DETECTION_STALE: "check the camera's rate and clocks",
    Code.UNREACHABLE: "move the robot to `suggested_base_pose`",
    Code.NO_CONTACT: "the target is not where it was said to be, or it moved",
    Code.OVERCURRENT: "the target moved toward the charger, or `servo_stiffness` is wrong; charge current: have the "
    "limiter of the power stage looked at",
    Code.SERVO_FAULT: "see the message; `reboot_servos` clears latched errors",
    Code.STUCK: "the magnets hold: free the target by hand",
    Code.NO_TACTILE_CONTACT: "the pads missed the target's ridges",
    Code.TACTILE_STALE: "check the board's cable, tactile_node and misalignment_node",
    Code.CRITICAL_ANGLE: "level the target or the charger",
    Code.ESTIMATE_UNSURE: "check pads and target for dirt and damage",
    Code.MISALIGNED: "send the goal again; if it comes back, calibrate the pads",
    Code.NO_CHARGE_CURRENT: "target full or its input off; electrodes dirty",
    Code.SHORT_CIRCUIT: "look for what lies between them; clean or realign them",
    Code.POWER_STALE: "check the board's cable and tactile_node",
    Code.REVERSE_POLARITY: "rewire the target",
    Code.VOLTAGE_OUT_OF_RANGE: "the target needs another charger",
    Code.REVERSE_CURRENT: "have the target's charging input looked at",
    Code.CONTACTOR_WELDED: "switch the battery off, replace the contactor",
    Code.INTERNAL: "send the log",
}
"""By code, as the table begins; empty where there is nothing to do."""
