# SPDX-License-Identifier: Apache-2.0
"""What everybody may assume: environment, declared parameters, the machine's constants, files. No ROS."""
