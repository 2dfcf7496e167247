# SPDX-License-Identifier: Apache-2.0
"""Where the light model has been shown to be right; written by `deltacharger report simulation`, never by hand.

A cell is '+' where nothing diverged, the settled force is within 0.5 % of a bisection, the path within 0.3 mm
rms of the converged course of the charger on its axis and the peak force within 15 % of its peak; 's' where the
peak is not, 'p' where the path is not, 'f' where the force is not, 'd' where it diverged, was reset or did not
come to rest.
"""

from __future__ import annotations

PROVEN = "+"
STEPS = (0.0001, 0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1)  # s
CONTACT_STIFFNESSES = (1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9)  # N/m
SERVO_STIFFNESSES = (2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0)  # N·m/rad
# For each servo stiffness, for each contact stiffness: a character for each step.
CELLS = (
    ("+++++++ppp", "+++++++ppp", "++++++++p+", "++++++++p+", "++++++++p+", "++++++++p+", "++++++++p+"),
    ("+++++++p++", "++++++++++", "++++++++++", "++++++++++", "++++++++++", "++++++++++", "++++++++++"),
    ("+++++++p+p", "+++++++p+p", "+++++++++p", "++++++++pp", "++++++++pp", "++++++++pp", "++++++++pp"),
    ("+++++++ppp", "++++++++pp", "++++++++pp", "++++++++pp", "++++++++pp", "++++++++pp", "++++++++pp"),
    ("+++++++ppp", "+++++++ppp", "++++++++pp", "++++++++pp", "++++++++pp", "++++++++pp", "++++++++pp"),
    ("+++++++ppp", "++++++++pp", "++++++++pp", "++++++++pp", "++++++++pp", "++++++++pp", "++++++++pp"),
    ("+++++++ppp", "++++++++pp", "++++++++pp", "++++++++pp", "++++++++pp", "++++++++pp", "++++++++pp"),
)
