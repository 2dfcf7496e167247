# SPDX-License-Identifier: Apache-2.0
"""A charging charger, ended by each signal that people, containers and systemd send, without launch.

Started by `deltacharger up`, and as nodes in separate processes. Each time, the contactor is open within 350 ms and the
arm ends without torque. A wrongly configured process ends with 2 and a reason. Under launch: test_charger_launch.py.
"""

import os
import signal
import sys
import time
from collections.abc import Callable
from typing import Any

import pytest

from deltacharger_bringup.scenes.scene import load_scene, parse_scene

from ..chargers import Process, wait_until
from ..marks import rest
from ..quick import QUICK
from ..running_charger import RunningCharger, node_command, up
from ..waiting import host
from .processes import ALARM, CONTAINER, OPEN, first, lives, needs_containers

pytestmark = pytest.mark.ros

INT, TERM, HUP = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
Start = Callable[..., Process]
SCENE = parse_scene(QUICK, "stopped")


def stop(charger: RunningCharger, send: Callable[[], object], *codes: int) -> None:
    """Send signals while current flows; the processes must end with these codes, all safe and without an alarm."""
    processes = list(charger.processes.values())
    before, at = [len(each.err) for each in processes], charger.world.time
    send()
    assert charger.opened(at) < host(OPEN)
    assert [each.end() for each in processes] == list(codes), [each.err for each in processes]
    charger.assert_safe()
    lines = [line for each, count in zip(processes, before, strict=True) for line in each.err[count:]]
    assert not [line for line in lines if ALARM.search(line)], lines


@pytest.mark.parametrize(
    ("signals", "code"),
    [pytest.param((INT, INT), 130, marks=pytest.mark.witness), rest((TERM,), 0), rest((HUP, TERM), 0)],
)
def test_up_makes_a_charging_charger_safe(context: Any, signals: tuple[int, ...], code: int) -> None:
    with RunningCharger(SCENE, context, command=up) as charger:
        charger.charge()
        stop(charger, lambda: [charger.signal(number) for number in signals], code)


@needs_containers
@pytest.mark.rest
@pytest.mark.parametrize(("number", "code"), [(TERM, 0), (INT, 130)])
def test_docker_stop_of_up_makes_a_charging_charger_safe(context: Any, number: int, code: int) -> None:
    with RunningCharger(SCENE, context, command=lambda *where: (*CONTAINER, *up(*where))) as charger:
        charger.charge()
        stop(charger, lambda: os.kill(first(charger.processes["charger"]), number), code)


@pytest.mark.rest
def test_nodes_as_processes_end_with_0_after_any_number_of_signals(context: Any) -> None:
    with RunningCharger(SCENE, context, apart=SCENE.nodes) as charger:
        charger.charge()
        processes = list(charger.processes.values())

        def send() -> None:
            charger.signal(INT)
            while any(each.process.poll() is None for each in processes):
                for each in processes:
                    each.process.send_signal(INT)  # as an impatient person or a supervisor does
                time.sleep(0.001)

        stop(charger, send, *[0] * len(processes))
        every = [line for each in processes for line in each.err]
    assert not [line for line in every if ALARM.search(line)], every


NODE = "from deltacharger_bringup.scenes.executables import docking_node; sys.exit(docking_node())"
COMMAND = "import runpy; runpy.run_module('deltacharger_bringup.cli', run_name='__main__')"


@pytest.mark.parametrize(
    ("words", "imported", "number", "code", "told"),
    [
        ((), "deltacharger_bringup.scenes.node_table", INT, 0, []),
        (("up",), "deltacharger_bringup.cli.main", INT, 130, ["interrupted"]),
        rest(("up",), "deltacharger_bringup.cli.charger", HUP, 0, []),
        rest(("dock",), "deltacharger_bringup.cli.dock", INT, 130, ["interrupted"]),
    ],
)
def test_a_signal_while_a_program_is_being_imported_ends_it_silently(
    start: Start, words: tuple[str, ...], imported: str, number: int, code: int, told: list[str]
) -> None:
    slow = (
        "import sys, time\n"
        "class Slow:\n"
        "    def find_spec(self, name, *more):\n"
        f"        if name == {imported!r}:\n"
        "            print('importing', flush=True)\n"
        "            time.sleep(0.5)\n"
        "sys.meta_path.insert(0, Slow())\n"
    )
    process = start(sys.executable, "-c", slow + (COMMAND if words else NODE), *words)
    process.wait_for_line("importing", process.out)
    assert process.end(number) == code
    assert (set(process.out), process.err) == ({"importing"}, told)  # it is also looked for before


@pytest.mark.rest
def test_a_process_ends_with_its_starter(start: Start, namespace: str) -> None:
    words = node_command(load_scene("mocks"), "kinematics_node", namespace)
    code = (
        "import os, subprocess, sys, time\n"
        "from deltacharger_core import signals\n"
        "child = subprocess.Popen(sys.argv[1:], env={**os.environ, **signals.end_with(os.getpid())})\n"
        "print(child.pid, flush=True)\n"
        "child.wait()\n"
    )
    starter = start(words[0], "-c", code, *words)
    wait_until(lambda: starter.out, "its process")
    node = int(starter.out[0])
    starter.process.kill()
    wait_until(lambda: not lives(node), "the end of the node")
