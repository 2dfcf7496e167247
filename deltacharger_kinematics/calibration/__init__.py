# SPDX-License-Identifier: Apache-2.0
"""Calibration of one arm: its dimensions from measured poses, its servos by the weight that they hold."""
