# SPDX-License-Identifier: Apache-2.0
"""Recorded dockings as text and pictures."""
