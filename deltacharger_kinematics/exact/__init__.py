# SPDX-License-Identifier: Apache-2.0
"""Arithmetic beyond doubles, for where rounding decides the answer."""
