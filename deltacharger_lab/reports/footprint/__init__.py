# SPDX-License-Identifier: Apache-2.0
"""The report on what a scene takes of a computer."""
