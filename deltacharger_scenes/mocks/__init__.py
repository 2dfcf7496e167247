# SPDX-License-Identifier: Apache-2.0
"""Nodes in the place of hardware, with laws instead of physics."""
