# SPDX-License-Identifier: Apache-2.0
"""Nodes that replace hardware, with simple rules instead of physics.

They publish any content on a topic, to test the layers above the drivers without drivers, ports or processes. The
parameter `fault` makes each one misbehave. Lease and trajectory rules are the real nodes' code; the contact model is
deltacharger_tactile's.
"""
