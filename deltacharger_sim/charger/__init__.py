# SPDX-License-Identifier: Apache-2.0
"""The simulated charger: the world behind emulated ports and a simulated camera, with its faults."""
