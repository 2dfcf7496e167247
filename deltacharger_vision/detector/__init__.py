# SPDX-License-Identifier: Apache-2.0
"""Detects the pose of the electrodes in an RGB-D image."""
