# SPDX-License-Identifier: Apache-2.0
"""Calibration of the camera's mount: boards, views and the fit."""
