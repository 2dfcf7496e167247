# SPDX-License-Identifier: Apache-2.0
"""The driver's own tests, loaded anew for other hardware: another board, another way to the servos."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType


def anew(name: str, group: str, **others: object) -> ModuleType:
    """Return a test module of the driver in which other objects stand under some names.

    It is loaded anew, and with it what it imports from beside it; the driver's own modules stay as they are.

    Args:
        name: of the module.
        group: of modules that get the same others; they share what is beside them.
        others: by the names that they take over.
    """
    if group not in sys.modules:
        package = ModuleType(group)
        package.__path__ = [str(Path(__file__).resolve().parent)]
        sys.modules[group] = package
    module = importlib.import_module(f"{group}.driver.{name}")
    for loaded in [each for path, each in sys.modules.items() if path.startswith(f"{group}.")]:
        vars(loaded).update({key: value for key, value in others.items() if key in vars(loaded)})
    return module


def borrowed_tests(module: ModuleType, without: set[str]) -> dict[str, object]:
    """Return a module's tests and fixtures by name, but those `without`, all of which it must have."""
    assert vars(module).keys() >= without
    return {
        name: value
        for name, value in vars(module).items()
        if (name.startswith("test_") and name not in without) or "Fixture" in type(value).__name__
    }
