# SPDX-License-Identifier: Apache-2.0
"""The driver's own tests of a board, loaded anew for another board."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

from .board_host import FirmwareBoard, FirmwarePlant

_PACKAGE = "tests_on_firmware"
_ANOTHER = {"BoardEmulator": FirmwareBoard, "BenchPlant": FirmwarePlant}


def on_firmware(name: str) -> ModuleType:
    """Return a test module of the driver whose board is the firmware and whose bench is the host program's.

    It is loaded anew, and with it what it imports from beside it; the driver's own modules stay as they are.
    """
    if _PACKAGE not in sys.modules:
        package = ModuleType(_PACKAGE)
        package.__path__ = [str(Path(__file__).resolve().parents[1])]
        sys.modules[_PACKAGE] = package
    module = importlib.import_module(f"{_PACKAGE}.driver.{name}")
    for loaded in [each for path, each in sys.modules.items() if path.startswith(f"{_PACKAGE}.")]:
        vars(loaded).update({key: value for key, value in _ANOTHER.items() if key in vars(loaded)})
    return module


def borrowed_tests(module: ModuleType, without: set[str]) -> dict[str, object]:
    """Return a module's tests and fixtures by name, but those `without`, all of which it must have."""
    assert vars(module).keys() >= without
    return {
        name: value
        for name, value in vars(module).items()
        if (name.startswith("test_") and name not in without) or "Fixture" in type(value).__name__
    }
