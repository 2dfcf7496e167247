# SPDX-License-Identifier: Apache-2.0
"""Which version of the package this is."""

from __future__ import annotations


def package_version() -> str:
    """Return it, or 'unknown' in a colcon workspace, which installs no metadata."""
    from importlib.metadata import PackageNotFoundError, version  # only where it is asked for: it takes 20 ms

    try:
        return version("deltacharger")
    except PackageNotFoundError:
        return "unknown"
