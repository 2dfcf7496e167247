# SPDX-License-Identifier: Apache-2.0
"""Nodes that replace hardware, with simple rules instead of physics.

They test the layers above the drivers without drivers, ports or processes. The parameter `fault` makes each one
misbehave while it runs. Lease and trajectory rules are the real nodes' code; the pads are the simulated ones.
"""
