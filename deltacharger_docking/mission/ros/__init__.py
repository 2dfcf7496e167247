# SPDX-License-Identifier: Apache-2.0
"""mission_node and its parts; everything here needs ROS."""
