# SPDX-License-Identifier: Apache-2.0
"""Emulators of servos and board that speak the real bytes."""
