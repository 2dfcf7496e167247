# SPDX-License-Identifier: Apache-2.0
"""Shared basis of all packages: environment, declared parameters, machine constants, files. No ROS."""
