# SPDX-License-Identifier: Apache-2.0
"""What all rooms stand on: declared parameters, machine constants, files, scripts; `ros/` for every node."""
