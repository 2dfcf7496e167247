# SPDX-License-Identifier: Apache-2.0
"""Reports: what the parts of DeltaCharger measure to, as pages with tables and pictures."""
