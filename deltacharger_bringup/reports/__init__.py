"""Reports: what the parts of DeltaCharger measure to, as pages with tables and pictures."""
