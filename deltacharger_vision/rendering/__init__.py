# SPDX-License-Identifier: Apache-2.0
"""Simulated cameras and their scenes."""
