# SPDX-License-Identifier: Apache-2.0
"""Nodes that replace hardware, with simple rules instead of physics.

They confront the layers above the drivers with any content of a topic, without drivers, ports or
processes. The parameter `fault` makes each one misbehave. Lease, contact model and parameters are the real nodes'.
"""
