# SPDX-License-Identifier: Apache-2.0
"""Simulated cameras and what they see."""
