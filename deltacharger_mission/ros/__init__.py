# SPDX-License-Identifier: Apache-2.0
"""The node of the mission; everything here knows ROS."""
