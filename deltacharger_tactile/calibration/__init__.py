# SPDX-License-Identifier: Apache-2.0
"""Calibration of one rig's pads."""
