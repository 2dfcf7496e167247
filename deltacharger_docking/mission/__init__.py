# SPDX-License-Identifier: Apache-2.0
"""A mission: drive to the target, search, dock, charge, undock and return."""
