# SPDX-License-Identifier: Apache-2.0
"""Loads the driver's tests again for other hardware: another board, another connection of the servos."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

from . import waiting


def anew(name: str, group: str, **others: object) -> ModuleType:
    """Return a newly loaded test module of the driver in which some names refer to other objects.

    Modules beside it that it imports are also loaded again, but for `waiting`, which knows this run's deadlines. The
    original modules stay unchanged.

    Args:
        name: module name.
        group: modules of one group share the modules beside them.
        others: replacements by name.
    """
    if group not in sys.modules:
        package = ModuleType(group)
        package.__path__ = [str(Path(__file__).resolve().parent)]
        sys.modules[group] = package
        sys.modules[f"{group}.waiting"] = waiting
    module = importlib.import_module(f"{group}.driver.{name}")
    for loaded in [each for path, each in sys.modules.items() if path.startswith(f"{group}.")]:
        vars(loaded).update({key: value for key, value in others.items() if key in vars(loaded)})
    return module


def borrowed_tests(module: ModuleType, without: set[str]) -> dict[str, object]:
    """Return a module's tests and fixtures by name, except those in `without`, which must exist."""
    assert vars(module).keys() >= without
    return {
        name: value
        for name, value in vars(module).items()
        if (name.startswith("test_") and name not in without) or "Fixture" in type(value).__name__
    }
