# SPDX-License-Identifier: Apache-2.0
"""What can be started: scene files, the table of nodes, composition in one process."""
