# SPDX-License-Identifier: Apache-2.0
"""Drivers of the servos and the board, and their nodes."""
