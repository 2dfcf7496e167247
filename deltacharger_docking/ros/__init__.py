# SPDX-License-Identifier: Apache-2.0
"""The nodes of docking; everything here knows ROS."""
