# SPDX-License-Identifier: Apache-2.0
"""Emulators of servos and board with the real protocols."""
