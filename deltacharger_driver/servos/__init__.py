# SPDX-License-Identifier: Apache-2.0
"""The servo bus: registers, packets, the controller and its node."""
