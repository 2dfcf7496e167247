# SPDX-License-Identifier: Apache-2.0
"""Docking records, replays, the live view, and recorded data sets."""
