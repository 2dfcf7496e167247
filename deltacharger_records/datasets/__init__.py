# SPDX-License-Identifier: Apache-2.0
"""Tactile data sets recorded on a charger."""
