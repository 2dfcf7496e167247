# SPDX-License-Identifier: Apache-2.0
"""Cameras on the charger: images, electrode detector, camera mount, and simulated cameras."""
