# SPDX-License-Identifier: Apache-2.0
"""Exceptions whose constructor takes other arguments than the message survive the transfer from a worker process."""

from __future__ import annotations

import pickle

from deltacharger_core.files import FileRefused
from deltacharger_core.parameters import ParameterError
from deltacharger_driver.errors import PortMissing
from deltacharger_tactile.errors import ModelError


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
