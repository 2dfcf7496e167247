# SPDX-License-Identifier: Apache-2.0
"""Inverse kinematics of the arm: three angles for a position of the platform, and servo currents for a force there.

Prints the arm angles and the solver's status for three points of charger_base (home, the dock, one too far away), the
position of the dock by forward kinematics, and the servo currents for a force of 17 N there.
"""

import numpy as np

from deltacharger_kinematics import Delta, Status

arm = Delta()  # the default dimensions; pass a DeltaGeometry for another arm
points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.080], [0.0, 0.0, 0.300]])  # m
solution = arm.inverse(points)
for point, angles, status in zip(points, solution.angles, solution.status, strict=True):
    print(f"{1000 * point} mm: {np.degrees(angles).round(2)}°, {Status(int(status))!r}")
back = arm.forward(solution.angles[1])
print(f"and back: {(1000 * back.position).round(6)} mm")
torque = arm.torque(points[1], (0.0, 0.0, 17.0))  # N·m
print(f"17 N along z: {(torque / (6.0 / 4.1)).round(3)} A")  # an MX-64 at 12 V stalls at 6.0 N·m and 4.1 A
