# SPDX-License-Identifier: Apache-2.0
"""Nodes in the place of hardware, with laws instead of physics.

They are there because what stands above the drivers must meet whatever a topic can say, without drivers, ports or
processes: each misbehaves by its parameter `fault`. Lease, contact model and parameters are those of the real nodes.
"""
