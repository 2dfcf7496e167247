# SPDX-License-Identifier: Apache-2.0
"""Live view of a charger in Rerun and RViz."""
