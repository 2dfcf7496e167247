# SPDX-License-Identifier: Apache-2.0
"""Constants that turn servo current into torque and weight into force."""

from __future__ import annotations

# MX-64 at 12 V: stall torque 6.0 N·m at 4.1 A (vendor's e-manual); ±5 %, and friction is extra.
TORQUE_CONSTANT = 6.0 / 4.1  # N·m/A
GRAVITY = (0.0, -9.81, 0.0)  # m/s² in charger_base: +y is up, +z points at the target
