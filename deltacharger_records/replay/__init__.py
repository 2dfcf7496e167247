# SPDX-License-Identifier: Apache-2.0
"""A recorded docking in words and pictures."""
