# SPDX-License-Identifier: Apache-2.0
"""The board link: packets, samples, the contactor and its node."""
