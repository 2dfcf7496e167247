# SPDX-License-Identifier: Apache-2.0
"""A charger that is not there: world, emulators of servos and board, simulated camera, virtual time, mock nodes."""
