# SPDX-License-Identifier: Apache-2.0
"""A node's log: any text becomes one line, and a blocked standard error does not block the process."""

import subprocess
import sys
from typing import Any

import pytest
from rclpy.node import Node

from deltacharger_core.ros.log import Log

from ..chargers import DEADLINE
from ..nodes import options

pytestmark = pytest.mark.ros

_BLOCKED = """
import os, sys
from deltacharger_core import environment
environment.prepare()
import rclpy
from rclpy.node import Node
from deltacharger_core.ros.log import Log
rclpy.init(args=[])
node = Node("subject")
log = Log(node)
reader, writer = os.pipe()
os.dup2(writer, 2)
os.set_blocking(writer, False)
try:
    while True:
        os.write(writer, bytes(4096))
except BlockingIOError:
    os.set_blocking(writer, True)
log.info("lost")
log.warning("lost too")
os.set_blocking(reader, False)
try:
    while os.read(reader, 65536):
        pass
except BlockingIOError:
    os.set_blocking(reader, True)
log.info("heard again")
sys.stdout.write(os.read(reader, 65536).decode())
"""


def test_control_characters_are_escaped_long_lines_cut_and_repeated_ones_throttled(
    context: Any, namespace: str, capfd: pytest.CaptureFixture[str]
) -> None:
    node = Node("subject", **options(context, namespace))
    log = Log(node)
    log.info("dock \x1b[31mred\r\n[ERROR] forged\x00: accepted")
    log.warning("x" * 5000)
    for _ in range(3):
        log.error("again", pause=60.0)
        log.error("another")
    node.destroy_node()
    first, second, *others = capfd.readouterr().err.splitlines()
    assert "dock \\u001b[31mred\\u000d\\u000a[ERROR] forged\\u0000: accepted" in first
    assert first.startswith("[INFO]")
    assert len(second) < 1200
    assert [line.rsplit(": ", 1)[1] for line in others] == ["again", *["another"] * 3]


@pytest.mark.rest
def test_lines_are_dropped_and_counted_while_standard_error_is_blocked() -> None:
    ended = subprocess.run(
        [sys.executable, "-c", _BLOCKED], capture_output=True, text=True, timeout=DEADLINE, check=False
    )
    assert ended.returncode == 0, ended.stderr
    first, second = [line.split(": ", 1)[1] for line in ended.stdout.splitlines()]
    assert first.startswith("2 lines")
    assert second == "heard again"
