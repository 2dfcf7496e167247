# SPDX-License-Identifier: Apache-2.0
"""The `deltacharger` command, a module for each of its commands."""
