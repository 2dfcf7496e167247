# SPDX-License-Identifier: Apache-2.0
"""`deltacharger simulate`: the emulated hardware of a scene in a separate process, without ROS."""

from __future__ import annotations

import argparse
import json
import threading
from pathlib import Path

from deltacharger_bringup.cli.files import file_to_write
from deltacharger_bringup.cli.output import (
    DONE,
    FAILED,
    WRONG_INPUT,
    CommandError,
    Interrupts,
    answer,
    log_line,
    print_text,
)
from deltacharger_bringup.cli.parser import DEFAULT_SCENE, namespace_option, scene_option
from deltacharger_bringup.cli.scene import load_for_command
from deltacharger_core import real_time, signals
from deltacharger_ros.outcomes import json_ready
from deltacharger_sim.charger.simulated_charger import SimulatedCharger

_QUIET = 0.6  # s without a byte from any host; then no node is left that could switch off torque or contactor
_LONGEST_LINGER = 3.0  # s


def add_simulate(parser: argparse.ArgumentParser) -> None:
    """Add the options of `simulate`."""
    scene_option(parser)
    namespace_option(parser)
    parser.add_argument("--directory", required=True, metavar="DIR", help="folder of the ports DIR/servo and DIR/board")
    parser.add_argument("--record", metavar="FILE", help="at the end, write the record of the simulated world as JSON")
    text = "end with 0 on Ctrl-C, as nodes do; for launch files"
    parser.add_argument("--as-node", action="store_true", help=text)


def simulate(options: argparse.Namespace) -> int:
    """Emulate the hardware until SIGINT or SIGTERM."""
    scene = load_for_command(options.scene or DEFAULT_SCENE)
    if scene.simulation is None:
        raise CommandError(
            f"scene '{scene.name}' has no key 'simulation': choose a simulated scene",
            WRONG_INPUT,
        )
    if options.record:
        file_to_write("--record", options.record)
    real_time.take_priority()  # no program delays a real board
    hardware = SimulatedCharger(scene.simulation, Path(options.directory), options.namespace)
    with Interrupts() as interrupts, hardware as charger:
        signals.follow_starter()
        if options.json:
            ports = {"servo": charger.servo_port, "board": charger.board_port}
            answer(options, {"ready": True, **ports, "scene": scene.name})
        else:
            print_text(f"servo {charger.servo_port}\nboard {charger.board_port}\nready")
        while not interrupts.event.wait(0.2):
            broken = charger.errors()
            if broken:
                raise CommandError(f"the simulated charger failed: {broken[0]!r}", FAILED)
        # Nodes that end by the same Ctrl-C still switch the torque off and open the contactor.
        hurry = threading.Event() if options.as_node else interrupts.impatient
        charger.wait_until_quiet(_QUIET, _LONGEST_LINGER, hurry)
        record = charger.record()
        if options.record:
            Path(options.record).write_text(json.dumps(json_ready(record), indent=2) + "\n", encoding="utf-8")
        log_line("in the simulated world: " + ", ".join(f"{key} {value}" for key, value in record.items()))
        return DONE if options.as_node else interrupts.exit_code(DONE)
