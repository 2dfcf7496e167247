# SPDX-License-Identifier: Apache-2.0
"""`deltacharger simulate` and `fault`: emulated hardware in a process of its own, without ROS, and faults of it."""

import argparse
import json
import os
import threading
from pathlib import Path
from typing import Any

from deltacharger_bringup.cli import arguments, output
from deltacharger_bringup.cli.charger import require_domain
from deltacharger_bringup.cli.scene import load_for_command
from deltacharger_core import environment, real_time, runtime, signals
from deltacharger_core.parameters import ParameterError
from deltacharger_core.ros.outcomes import json_ready
from deltacharger_sim.charger import fault_channel, faults, simulated_charger

_QUIET = 0.6  # s without a byte from any host; then no node is left that could switch off torque or contactor
_LONGEST_LINGER = 3.0  # s
_FLAGS = {"last": "--for-s", "servo": "--servo", "amount": "--amount"}


def add_simulate(parser: argparse.ArgumentParser) -> None:
    """Add the options of `simulate`."""
    add = parser.add_argument
    arguments.scene_option(parser)
    arguments.namespace_option(parser)
    add("--directory", required=True, metavar="DIR", help="folder of the ports DIR/servo and DIR/board")
    add("--record", metavar="FILE", help="at the end, write the record of the simulated world as JSON")
    add("--as-node", action="store_true", help="end with 0 on Ctrl-C, as nodes do; for launch files")


def simulate(options: argparse.Namespace) -> output.Result:
    """Emulate the hardware until SIGINT or SIGTERM."""
    scene = load_for_command(options.scene or arguments.DEFAULT_SCENE)
    if scene.simulation is None:
        raise output.WrongInput(f"scene '{scene.name}' has no key 'simulation': choose a simulated scene")
    if options.record:
        arguments.file_to_write("--record", options.record)
    real_time.take_priority()  # no program delays a real board
    hardware = simulated_charger.SimulatedCharger(scene.simulation, Path(options.directory), options.namespace)
    with output.Interrupts() as interrupts, hardware as charger:
        signals.follow_starter()
        ports = {"servo": charger.servo_port, "board": charger.board_port}
        text = "\n".join([*(f"{name} {port}" for name, port in ports.items()), "ready"])
        output.answer(options, output.Result(text, {"ready": True, **ports, "scene": scene.name}))
        while not interrupts.event.wait(0.2):
            broken = charger.errors()
            if broken:
                raise output.CommandError(f"the simulated charger failed: {broken[0]!r}")
        # Nodes that end by the same Ctrl-C still switch the torque off and open the contactor.
        hurry = threading.Event() if options.as_node else interrupts.impatient
        charger.wait_until_quiet(_QUIET, _LONGEST_LINGER, hurry)
        record = charger.record()
        if options.record:
            Path(options.record).write_text(json.dumps(json_ready(record), indent=2) + "\n", encoding="utf-8")
        remark = "in the simulated world: " + ", ".join(f"{key} {value}" for key, value in record.items())
        return output.Result(
            code=output.DONE if options.as_node else interrupts.exit_code(output.DONE), remarks=[remark]
        )


def add_fault(parser: argparse.ArgumentParser) -> None:
    """Add the options of `fault`."""
    add = parser.add_argument
    add("kind", nargs="?", metavar="KIND", help="kind of fault; see --list")
    add("--for-s", type=arguments.NOT_NEGATIVE, default=0.0, metavar="S", help="duration (until --clear)")
    add(
        "--amount",
        type=arguments.between(-1000000000.0, 1000000000.0),
        metavar="A",
        help="size, in the unit of its kind",
    )
    add("--servo", type=arguments.integer(1, 3), default=0, metavar="N", help="id, for faults of one servo")
    add("--list", action="store_true", help="list the kinds and the active faults")
    add("--clear", action="store_true", help="end all lasting faults")
    add("--directory", metavar="DIR", help="folder of the ports (default: by ROS domain)")
    arguments.namespace_option(parser)


def fault(options: argparse.Namespace) -> output.Result:
    """Inject one fault, end all, or list them."""
    if (options.kind is not None) + options.list + options.clear != 1:
        raise output.WrongInput("give exactly one of KIND, --list and --clear")
    require_domain()
    if options.kind is not None:
        return _inject(options, _checked(options))
    if options.amount is not None or options.servo or options.for_s:
        raise output.WrongInput("--amount, --servo and --for-s need a KIND")
    return _clear(options) if options.clear else _list(options)


def _checked(options: argparse.Namespace) -> faults.Fault:
    try:
        return faults.Fault(options.kind, last=options.for_s, servo=options.servo, amount=options.amount)
    except ParameterError as error:
        flag = _FLAGS.get(error.key)
        raise output.WrongInput(f"{flag}: {error.problem}" if flag else error.problem) from error


def _inject(options: argparse.Namespace, wanted: faults.Fault) -> output.Result:
    request: dict[str, Any] = {"command": "begin", "kind": wanted.kind, "last": wanted.last, "servo": wanted.servo}
    if wanted.amount is not None:
        request["amount"] = wanted.amount
    reply = _ask(options, request)
    kind = faults.KINDS[wanted.kind]
    injected: dict[str, Any] = {"kind": wanted.kind, "servo": wanted.whom or None, "for_s": wanted.last or None}
    injected["amount"] = wanted.how_much if kind.amount else None
    until = f", for {wanted.last:g} s" if wanted.last else ", until --clear"
    text = f"{_named(injected)}: {kind.text}{until if kind.lasts else ''}"
    return output.Result(text, {**injected, "active": reply["active"]})


def _clear(options: argparse.Namespace) -> output.Result:
    reply = _ask(options, {"command": "clear"})
    text = "no faults are active; latched errors of servos and board stay until they are cleared"
    return output.Result(text, {"active": reply["active"]})


def _list(options: argparse.Namespace) -> output.Result:
    try:
        active = _ask(options, {"command": "active"})["active"]
    except output.CommandError:
        active = None
    lines = []
    for name, kind in faults.KINDS.items():
        amount = f"; amount: {kind.amount.name}, usually {kind.amount.default:g}" if kind.amount else ""
        servo = {"one": "; --servo, usually 2", "some": "; --servo, usually all"}.get(kind.servo, "")
        lines.append(f"{name:20} {kind.text}{amount}{servo}{'' if kind.lasts else '; momentary'}")
    begun = None if active is None else "active: " + ("; ".join(_named(each) for each in active) or "none")
    lines += ["", begun or _none_runs(options)]
    return output.Result(
        "\n".join(lines), {"kinds": {name: kind.text for name, kind in faults.KINDS.items()}, "active": active}
    )


def _named(each: dict[str, Any]) -> str:
    words = [each["kind"]]
    if each["servo"]:
        words.append(f"of servo {each['servo']}")
    if each["amount"] is not None:
        words.append(f"({each['amount']:g})")
    if each.get("remaining_s") is not None:
        words.append(f"for {each['remaining_s']:.1f} s more")
    return " ".join(words)


def _ask(options: argparse.Namespace, request: dict[str, Any]) -> dict[str, Any]:
    """Send a request to the charger that the options name.

    Raises:
        CommandError: no charger runs, or it refuses.
    """
    for path in _places(options):
        try:
            reply = fault_channel.ask(path, request)
        except ConnectionError:
            continue
        except OSError as error:
            raise output.CommandError(
                f"{path}: {error}; does the charger belong to another user, or does it hang?"
            ) from error
        if not reply["success"]:
            raise output.CommandError(reply["error"])
        return reply
    raise output.CommandError(_none_runs(options))


def _places(options: argparse.Namespace) -> list[Path]:
    """Return possible paths of the charger's socket: in the folder of its ports, or by ROS domain."""
    if options.directory:
        return [Path(options.directory) / fault_channel.SOCKET]
    return [runtime.charger(domain, options.namespace) for domain in _domains()]


def _domains() -> list[int]:
    """Return the given ROS domain, or else the domain of simulated scenes and domain 0."""
    return [environment.domain()] if os.environ.get("ROS_DOMAIN_ID") else [environment.SIMULATION_DOMAIN, 0]


def _none_runs(options: argparse.Namespace) -> str:
    if options.directory:
        return f"no simulated charger runs on the ports in {options.directory}"
    where = " or ".join(str(domain) for domain in _domains())
    space = f" under the namespace '{options.namespace}'" if options.namespace else ""
    return f"no simulated charger runs in ROS domain {where}{space}: start one with `deltacharger up`"
