# SPDX-License-Identifier: Apache-2.0
"""docking_node and its parts; everything here needs ROS."""
