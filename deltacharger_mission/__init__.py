# SPDX-License-Identifier: Apache-2.0
"""The errand around a docking: drive, search, dock, charge, undock, return."""
