# SPDX-License-Identifier: Apache-2.0
"""Geometry parameters of nodes that use the arm."""
