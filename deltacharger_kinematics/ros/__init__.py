# SPDX-License-Identifier: Apache-2.0
"""What nodes share that need the arm: its geometry as parameters."""
