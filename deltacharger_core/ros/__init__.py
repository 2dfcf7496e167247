# SPDX-License-Identifier: Apache-2.0
"""Shared ROS parts of the nodes: parameters, executor, quality of service, raw topics, and a client."""
