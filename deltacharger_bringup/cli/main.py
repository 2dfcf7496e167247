# SPDX-License-Identifier: Apache-2.0
"""The `deltacharger` command. Each subcommand has a module with its options.

Exit codes: 0 done, 1 the job failed, 2 wrong usage or input, 130 interrupted. With `--json` exactly one JSON object
is written to stdout. Progress and logs are always written to stderr.
"""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import sys
import threading
import warnings
from collections.abc import Sequence
from functools import partial
from types import FrameType
from typing import Any

from deltacharger_bringup.cli.output import (
    DONE,
    FAILED,
    INTERRUPTED,
    WRONG_INPUT,
    CommandError,
    from_os_error,
    log_line,
    write_json,
)
from deltacharger_bringup.cli.parser import Parser, Version, add_command
from deltacharger_core import streams
from deltacharger_core.environment import UnsupportedRos

GROUPS = {
    "scene": ("list, check or explain scenes", "Inspect scenes."),
    "calibrate": (
        "measure this charger's dimensions, servos, camera and pads",
        "Measure this charger's dimensions, servos, camera and pads.",
    ),
    "report": ("measure a part and write a page", "Measure a part and write a page of the results."),
    "tactile": (
        "simulate tactile data, train and evaluate classifiers of misalignment",
        "Simulate tactile data, train and evaluate classifiers of misalignment.",
    ),
    "vision": ("find electrodes in images", "Find electrodes in images."),
}
"""Group of commands: its line in the list of commands, and its description."""

COMMANDS = {
    "up": "run a charger in this process until it is stopped; prints 'ready' when its actions are available",
    "dock": "dock and charge with the running charger; starts one if none runs",
    "undock": "stop charging, release the target and retract the arm of the running charger",
    "scene list": "list the packaged scenes",
    "scene check": "check scenes and report problems; a node checks its parameters when it starts",
    "scene explain": "show what a scene sets and every key it could set",
    "simulate": "emulate the servos and the board of a scene on two ports, without ROS; prints their paths and 'ready'",
    "fault": "inject a fault into the emulated hardware of a running charger",
    "doctor": "check this computer, its ports and the connected devices; report problems and how to fix them",
    "calibrate kinematics": "plan and measure poses of the arm, and fit its geometry to them",
    "calibrate servos": "measure stiffness, torque constant, friction and play of the running charger's servos",
    "calibrate tactile": "find gains, dead taxels and constant errors of one rig's pads from dockings at known poses",
    "calibrate camera": "find the pose of the camera from images of a board on the platform",
    "report kinematics": (
        "error against run time of inverse and forward kinematics, extremes, and pictures of the workspace"
    ),
    "report tactile": (
        "compare classifiers of misalignment on simulated data: accuracy, run time, splits, shifts, confidence"
    ),
    "report vision": (
        "the electrode detector on simulated images: detections, errors, run time, false alarms, both renderers"
    ),
    "report simulation": "error against run time, stability, energy and extremes of the simulated charger's mechanics",
    "report docking": "thousands of simulated dockings: charged, refused, unsafe; repeat the command to resume",
    "report footprint": (
        "resources that each scene needs: processes, start-up, memory, CPU at rest and docking, libraries (Linux)"
    ),
    "tactile generate": "write a simulated data set",
    "tactile record": "dock the running charger at known offsets and record its pads; repeat the command to resume",
    "tactile train": "train a classifier",
    "tactile evaluate": "evaluate a trained classifier",
    "tactile models": "list the packaged models that misalignment_node serves: accuracy, size and time",
    "tactile compare": "compare all models on simulated data; same as `report tactile`",
    "vision detect": "find a terminal's electrodes in one image, in a folder of images or in a recording",
    "campaign": "simulate many dockings without ROS, faster than real time; repeat the command to resume",
    "replay": "explain why a recorded docking ended as it did, and draw it; or list the records in a folder",
    "view": "show a running charger or a recording of one: mechanism, camera, pads, currents, states, decisions",
}
"""Command: what it does. The function has the command's name; its module has that name or the name of the group."""

_ELSEWHERE = {
    "scene list": "scene.list_scenes",
    "calibrate kinematics": "calibrate_kinematics.kinematics",
    "calibrate servos": "calibrate_servos.servos",
    "calibrate tactile": "calibrate_tactile.tactile",
    "calibrate camera": "calibrate_camera.camera",
    "tactile record": "tactile_record.record",
    "tactile compare": "report.tactile",
}

_SOON = 0.01  # s, after which an interruption is repeated
_LONGEST_WORD = 4096  # characters; also the limit of a path

_EXTRA_OF = {
    "scipy": "calibrate",
    **dict.fromkeys(("jinja2", "markdown_it", "matplotlib", "mpmath", "psutil"), "report"),
    **dict.fromkeys(("sklearn", "torch", "xgboost"), "train"),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if arguments is None:
        streams.secure()
        warnings.showwarning = _show_warning
    try:
        code = _run(words) if arguments is not None else _interruptible(words)
    except SystemExit as end:  # argparse has printed its help or an error
        code = int(end.code or DONE)
    return streams.ended(code)


def _interruptible(words: list[str]) -> int:
    sys.unraisablehook = _repeat
    try:
        signal.signal(signal.SIGINT, _interrupt)  # until the command, imported later, handles signals
        return _run(words)
    except KeyboardInterrupt:
        if "--as-node" in words:  # nodes then end with 0
            return DONE
        log_line("interrupted")
        if "--json" in words:
            write_json({"success": False, "error": "interrupted"})
        return INTERRUPTED
    finally:
        if signal.getsignal(signal.SIGINT) is _interrupt:  # nothing catches it while the interpreter ends
            signal.signal(signal.SIGINT, signal.SIG_DFL)


def _show_warning(message: Warning | str, *where: object, **more: object) -> None:
    log_line(f"warning: {message}")


def _interrupt(number: int, frame: FrameType | None) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second one must not stop the clean-up
    raise KeyboardInterrupt


def _repeat(lost: Any) -> None:
    """Interrupt once more if the interruption came to a destructor or to the import system, which drop exceptions."""
    if lost.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(lost)
    elif signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, _interrupt)
        threading.Timer(_SOON, os.kill, (os.getpid(), signal.SIGINT)).start()


def _run(words: list[str]) -> int:
    Parser.wants_json = "--json" in words
    options = argparse.Namespace(json=Parser.wants_json)
    try:
        _require_plain(words)
        parser = build_parser()
        parser.parse_args(words, options)
        if not hasattr(options, "run"):
            parser.print_help(sys.stderr)
            return WRONG_INPUT
        return int(options.run(options))
    except CommandError as error:
        failure = error
    except UnsupportedRos as error:  # its message is already printed
        if options.json:
            write_json({"success": False, "error": str(error)})
        return WRONG_INPUT
    except OSError as error:
        failure = from_os_error(error)
    except UnicodeError as error:
        failure = CommandError(f"a name or text is not UTF-8 ({error}); rename or change it", WRONG_INPUT)
    except Exception as error:
        known = _known(error)
        if known is None:
            raise
        failure = known
    text = streams.shortened(str(failure))
    log_line(text)
    if options.json:
        write_json({"success": False, "error": text, **failure.details})
    return failure.exit_code


def _require_plain(words: list[str]) -> None:
    """Refuse words that, when printed, would control the terminal, end the line or fill it."""
    for word in words:
        if streams.plain(word) != word:
            shown = streams.plain(streams.shortened(word))
            raise CommandError(f"'{shown}' contains control characters: rename or retype it", WRONG_INPUT)
        if len(word) > _LONGEST_WORD:
            raise CommandError(f"'{word[:20]}…' has {len(word)} characters, more than any name or path", WRONG_INPUT)


def _known(error: Exception) -> CommandError | None:
    """Return an error that names the missing library or what ROS refuses; None for a defect."""
    name = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    if name == "cv2":  # its message says how to install it; FAILED would mean that no electrodes were found
        return CommandError(str(error), WRONG_INPUT)
    if name in _EXTRA_OF:
        others = ", or by rosdep with DELTACHARGER_EXTRAS=all" if name == "scipy" else ""  # what a robot needs
        return CommandError(f"{name} is not installed; install deltacharger[{_EXTRA_OF[name]}]{others}", FAILED)
    if "rclpy" in sys.modules:  # commands without ROS must not import it only to report an error
        from deltacharger_ros.client import ClientError
        from deltacharger_ros.node_support import ros_problem

        if isinstance(error, ClientError):
            return CommandError(str(error), FAILED)
        problem = ros_problem(error)
        return CommandError(problem, WRONG_INPUT) if problem else None
    return None


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the command with all subcommands."""
    parser: argparse.ArgumentParser = Parser(
        prog="deltacharger",
        description="Run, try and inspect DeltaCharger, a robot arm that docks to other robots and charges them.",
        epilog="Exit codes: 0 done, 1 the job failed, 2 wrong usage or input, 130 interrupted. "
        "Simulated scenes use ROS_DOMAIN_ID=87 and this machine only, unless ROS_DOMAIN_ID and "
        "ROS_AUTOMATIC_DISCOVERY_RANGE are set.",
    )
    parser.add_argument("--version", action=Version, nargs=0, help="print the version")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    groups: dict[str, argparse._SubParsersAction[argparse.ArgumentParser]] = {"": commands}
    for name, text in COMMANDS.items():
        group, _, action = name.rpartition(" ")
        if group not in groups:
            about, description = GROUPS[group]
            own = commands.add_parser(group, help=about, description=description)
            groups[group] = own.add_subparsers(title="actions", metavar="ACTION", required=True)
        where = _ELSEWHERE.get(name, f"{group or action}.{action}")
        add_command(groups[group], action, text, partial(_fill, where))
    return parser


def _fill(where: str, parser: argparse.ArgumentParser) -> None:
    """Import a command's module only when it is used, and add the options by its `add_…` function."""
    name, _, function = where.partition(".")
    module = importlib.import_module(f"deltacharger_bringup.cli.{name}")
    add = getattr(module, f"add_{function}", None)  # a command may have no options
    if add is not None:
        add(parser)
    parser.set_defaults(run=getattr(module, function))
