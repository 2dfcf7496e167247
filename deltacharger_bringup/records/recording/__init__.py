# SPDX-License-Identifier: Apache-2.0
"""A charger's topics in files."""
