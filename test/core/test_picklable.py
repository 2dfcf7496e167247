# SPDX-License-Identifier: Apache-2.0
"""Every exception of the package survives the transfer from a worker process."""

from __future__ import annotations

import importlib
import pickle
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from deltacharger_core.files import FileRefused
from deltacharger_core.parameters import ParameterError
from deltacharger_driver.errors import PortMissing
from deltacharger_tactile.errors import ModelError

ROOT = Path(__file__).resolve().parents[2]
DEFINES = re.compile(r"^class \w+\(.*(Error|Exception)\b", re.MULTILINE)


def below(kind: type[BaseException]) -> Iterator[type[BaseException]]:
    for child in kind.__subclasses__():
        yield child
        yield from below(child)


def kinds() -> list[type[BaseException]]:
    for path in sorted(ROOT.glob("deltacharger_*/**/*.py")):
        if DEFINES.search(path.read_text("utf-8")):
            try:
                importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
            except ModuleNotFoundError:  # needs an extra or ROS
                continue
    return sorted({kind for kind in below(BaseException) if kind.__module__.startswith("deltacharger_")}, key=repr)


@pytest.mark.rest
def test_every_exception_keeps_message_and_values() -> None:
    found = kinds()
    assert {ModelError, ParameterError, PortMissing} < set(found)
    for kind in set(found) - {FileRefused}:  # which keeps its values where OSError does; see below
        error = kind.__new__(kind)
        error.args = ("what is wrong",)
        error.detail = 3  # type: ignore[attr-defined]
        back = pickle.loads(pickle.dumps(error))
        assert (type(back), back.args, back.detail) == (kind, error.args, 3), kind


def test_the_message_survives_pickling() -> None:
    for error in (
        ModelError("a.npz", "it is empty"),
        ParameterError("servo.stiffness", -1.0, "is below 0"),
        PortMissing("/dev/ttyUSB9", "no such file"),
        FileRefused("/dev/zero", "it is a device"),
    ):
        back = pickle.loads(pickle.dumps(error))
        assert (type(back), str(back), vars(back)) == (type(error), str(error), vars(error))
        assert getattr(back, "filename", None) == getattr(error, "filename", None)
