# SPDX-License-Identifier: Apache-2.0
"""What happened: recordings, replays, the live view, recorded data sets."""
