"""The driver's own tests of a board, loaded anew for another board."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

from .board_host import FirmwareBoard, FirmwarePlant

DRIVER_TESTS = Path(__file__).resolve().parents[1] / "driver"


def on_firmware(name: str) -> ModuleType:
    """Return a test module of the driver whose board is the firmware and whose bench is the host program's."""
    spec = importlib.util.spec_from_file_location(f"firmware_{name}", DRIVER_TESTS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    vars(module).update(BoardEmulator=FirmwareBoard, BenchPlant=FirmwarePlant)
    return module


def borrowed_tests(module: ModuleType, without: set[str]) -> dict[str, object]:
    """Return a module's tests and fixtures by name, but those `without`, all of which it must have."""
    assert vars(module).keys() >= without
    return {
        name: value
        for name, value in vars(module).items()
        if (name.startswith("test_") and name not in without) or "Fixture" in type(value).__name__
    }
