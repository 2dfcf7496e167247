# SPDX-License-Identifier: Apache-2.0
"""ROS helpers shared by the vision nodes and their clients."""
