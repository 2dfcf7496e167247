# SPDX-License-Identifier: Apache-2.0
"""A charger in virtual time."""
