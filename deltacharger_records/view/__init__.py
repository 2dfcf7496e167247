# SPDX-License-Identifier: Apache-2.0
"""A charger at work in Rerun and RViz."""
