# SPDX-License-Identifier: Apache-2.0
"""Cameras on the charger: images, the electrode detector, where the camera sits, and simulated cameras."""
