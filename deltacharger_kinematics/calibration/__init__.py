# SPDX-License-Identifier: Apache-2.0
"""Calibration of one arm: dimensions from measured poses, servos from the weight that they hold."""
