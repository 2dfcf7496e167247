# SPDX-License-Identifier: Apache-2.0
"""Options of the suite: real devices for the driver's contract tests, the host's deadlines."""

import argparse

import pytest
from hypothesis import settings

from .chargers import context, deltacharger, namespace, quick_file, quick_scene, spin, start  # noqa: F401
from .waiting import widen

DEVICES = ("servo", "board")

settings.register_profile("suite", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("suite")


def _port(text: str) -> tuple[str, str]:
    device, _, path = text.partition("=")
    if device not in DEVICES or not path:
        raise argparse.ArgumentTypeError(
            f"'{text}' names no device's port; write servo=PATH or board=PATH, such as servo=/dev/deltacharger_servo"
        )
    return device, path


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("deltacharger", "the driver's contract on real hardware (test/driver/contract)")
    group.addoption(
        "--port",
        action="append",
        type=_port,
        default=[],
        metavar="DEVICE=PATH",
        help="run the contract on a real device in place of the emulators: servo=PATH or board=PATH, each at most once",
    )
    group.addoption(
        "--move",
        action="store_true",
        help="with --port servo=PATH: switch torque on and move each servo by a few degrees",
    )
    group.addoption(
        "--close-contactor",
        action="store_true",
        help="with --port board=PATH: close the contactor onto a load that is connected to the electrodes",
    )
    group = parser.getgroup("deltacharger's suite")
    group.addoption(
        "--host-deadlines",
        type=float,
        default=1.0,
        metavar="FACTOR",
        help="widen the deadlines that this computer must keep, for tests beside other work; 1 = strict",
    )


def pytest_configure(config: pytest.Config) -> None:
    widen(config.getoption("--host-deadlines"))
