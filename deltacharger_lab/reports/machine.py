# SPDX-License-Identifier: Apache-2.0
"""The machine that a report was written on, and the versions of what it measured with."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any


def machine(libraries: Iterable[str]) -> dict[str, Any]:
    """Return processor, cores, load, system, Python and the versions of those libraries that are installed."""
    versions = {}
    for name in libraries:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    about = {"cores": os.cpu_count(), "system": platform.system(), "python": platform.python_version()}
    return {**about, "processor": processor(), "load": os.getloadavg()[0], "versions": versions}


def processor() -> str:
    """Return what the processor calls itself."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        lines = []
    names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())
