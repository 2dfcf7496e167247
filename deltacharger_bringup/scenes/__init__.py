# SPDX-License-Identifier: Apache-2.0
"""Scene files, the table of nodes, and composition in one process."""
