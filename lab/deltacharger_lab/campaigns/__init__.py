# SPDX-License-Identifier: Apache-2.0
"""Campaigns: thousands of simulated dockings without ROS, each drawn from the campaign's seed and its number."""
