# SPDX-License-Identifier: Apache-2.0
"""Reports: measurements of DeltaCharger's parts, as pages with tables and pictures."""
