# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the doctor's tests: emulated hardware behind real pseudo-terminals."""

from ...emulated_ports import board, board_port, one_cable, servo_port, servos, silent_port

__all__ = ("board", "board_port", "one_cable", "servo_port", "servos", "silent_port")
