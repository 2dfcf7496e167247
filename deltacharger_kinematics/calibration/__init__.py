# SPDX-License-Identifier: Apache-2.0
"""Kinematic calibration: from measured poses to the dimensions of one arm."""
