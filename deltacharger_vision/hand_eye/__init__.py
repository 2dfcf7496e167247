# SPDX-License-Identifier: Apache-2.0
"""Where the camera sits: boards, views and the fit."""
