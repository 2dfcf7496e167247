# SPDX-License-Identifier: Apache-2.0
"""From an RGB-D image to the pose of the electrodes."""
