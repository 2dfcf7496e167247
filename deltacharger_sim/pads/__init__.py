# SPDX-License-Identifier: Apache-2.0
"""The pads of a simulated charger, and data sets of simulated dockings."""
