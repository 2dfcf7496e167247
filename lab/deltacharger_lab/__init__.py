# SPDX-License-Identifier: Apache-2.0
"""Measurements: campaigns, reports and generated pages."""
