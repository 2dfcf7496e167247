# SPDX-License-Identifier: Apache-2.0
"""Version of the package."""

from __future__ import annotations


def package_version() -> str:
    """Return the version; 'unknown' in a colcon workspace, which installs no metadata."""
    from importlib.metadata import PackageNotFoundError, version  # here, because the import takes 20 ms

    try:
        return version("deltacharger")
    except PackageNotFoundError:
        return "unknown"
