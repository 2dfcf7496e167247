# SPDX-License-Identifier: Apache-2.0
"""MuJoCo as the reference of the simulated mechanics and images."""
