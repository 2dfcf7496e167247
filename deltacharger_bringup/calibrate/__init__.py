# SPDX-License-Identifier: Apache-2.0
"""What the dialogues of calibration gather and tell."""
