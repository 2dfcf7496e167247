# SPDX-License-Identifier: Apache-2.0
"""Arithmetic beyond doubles, for points whose result depends on rounding."""
