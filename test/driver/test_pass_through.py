# SPDX-License-Identifier: Apache-2.0
"""One cable for servos and pads: bytes pass the board unchanged, and faults behind it are reported."""

import random
from pathlib import Path
from typing import Any

import pytest
from deltacharger.msg import ServoState

from deltacharger_core import runtime
from deltacharger_core.environment import domain
from deltacharger_core.ros.node_support import StartupError
from deltacharger_driver.board import protocol, tactile_node
from deltacharger_driver.ports import open_serial
from deltacharger_driver.servos import servo_node
from deltacharger_driver.servos.servo_node import ServoNode

from ..behind_board import BehindEmulator, BehindFirmware
from ..emulated_ports import Babbler
from ..marks import rest
from ..nodes import options
from ..quick import PATIENT_MARGIN
from ..waiting import wait_until

pytestmark = pytest.mark.ros


@pytest.mark.parametrize("kind", [BehindEmulator, rest(BehindFirmware)])
def test_bytes_pass_unchanged(kind: type[BehindEmulator]) -> None:
    echo, source = Babbler(), random.Random(24)
    with kind(echo) as terminal, open_serial(terminal.path, 1_000_000) as line:
        for size in (1, 10, protocol.LONGEST_SERVO, protocol.LONGEST_SERVO + 1, 1000):
            sent, back = source.randbytes(size), bytearray()
            line.write(sent)
            wait_until(lambda back=back, size=size: back.extend(line.read(4096)) or len(back) >= size)
            assert back == sent
            assert echo.received.endswith(sent)
    assert not Path(terminal.path).is_symlink()


@pytest.mark.witness
def test_both_nodes_on_one_cable(context: Any, namespace: str, spin: Any, one_cable: str) -> None:
    spin(tactile_node.TactileNode(**options(context, namespace, port=one_cable)))
    node = spin(ServoNode(**options(context, namespace, port="board", rate=60.0, reply_margin=PATIENT_MARGIN)))
    states: list[ServoState] = []
    node.create_subscription(ServoState, "servo_state", states.append, 10)
    wait_until(lambda: len(states) > 60)
    assert all(list(state.valid) == [True] * 3 for state in states[-30:])
    assert runtime.servos(domain(), namespace).is_symlink()


def test_missing_servos_behind_the_board_are_reported(
    context: Any, namespace: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(servo_node, "_BOARD_TIMEOUT", 0.1)
    with pytest.raises(StartupError, match="no servos"):
        ServoNode(**options(context, namespace, port="board"))
