# SPDX-License-Identifier: Apache-2.0
"""Images from cameras, from recordings and from topics."""
