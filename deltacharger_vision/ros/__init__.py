# SPDX-License-Identifier: Apache-2.0
"""What of vision its nodes and those who hear them share of ROS."""
