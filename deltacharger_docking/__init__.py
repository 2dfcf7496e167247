# SPDX-License-Identifier: Apache-2.0
"""Docking as a pure state machine: observation in, command out; the observation carries the time.

`machine.DockingMachine` runs Algorithm 1 of the paper and its reverse. `docking_node` is the thin ROS shell around it.
"""
