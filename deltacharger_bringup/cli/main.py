# SPDX-License-Identifier: Apache-2.0
"""The `deltacharger` command: its commands, options and exit codes; what each does stands in the module beside it.

Exit codes: 0 done, 1 the job failed, 2 wrong usage or input, 130 interrupted. With `--json` exactly one JSON object
goes to stdout; progress and logs always go to stderr.
"""

from __future__ import annotations

import argparse
import importlib
import math
import signal
import sys
import warnings
from collections.abc import Sequence
from types import FrameType

from deltacharger_bringup.cli.calibrate_options import add_camera, add_kinematics, add_tactile_calibration
from deltacharger_bringup.cli.campaign_options import add_campaign
from deltacharger_bringup.cli.hardware_options import add_doctor, add_fault, add_simulate
from deltacharger_bringup.cli.output import FAILED, INTERRUPTED, WRONG_INPUT, CommandError, say, write_json
from deltacharger_bringup.cli.overrides import add_overrides
from deltacharger_bringup.cli.parser import Parser, Version, add_command
from deltacharger_bringup.cli.replay_options import add_record, add_recording, add_replay
from deltacharger_bringup.cli.report_options import add_reports
from deltacharger_bringup.cli.tactile_options import add_tactile
from deltacharger_bringup.cli.types import DEGREES, MILLIMETRES, POSITIVE, deadline, namespace
from deltacharger_bringup.cli.view_options import add_view
from deltacharger_bringup.cli.vision_options import add_vision

DEFAULT_SCENE = "simulated"
DEFAULT_PICTURE = "dock.png"

_EXTRA_OF = {"scipy": "calibrate", "jinja2": "report", "markdown_it": "report", "psutil": "report"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; the entry point."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if arguments is not None:
        return _run(words)
    warnings.showwarning = _show_warning
    try:
        signal.signal(signal.SIGINT, _interrupt)  # until the command, imported later, takes signals over
        return _run(words)
    except KeyboardInterrupt:
        say("interrupted")
        if "--json" in words:
            write_json({"success": False, "error": "interrupted"})
        return INTERRUPTED
    finally:
        if signal.getsignal(signal.SIGINT) is _interrupt:  # nobody catches it while the interpreter ends
            signal.signal(signal.SIGINT, signal.SIG_DFL)


def _show_warning(message: Warning | str, *where: object, **more: object) -> None:
    say(f"warning: {message}")


def _interrupt(number: int, frame: FrameType | None) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second one must not break off what the first one started
    raise KeyboardInterrupt


def _run(words: list[str]) -> int:
    Parser.wants_json = "--json" in words
    parser = build_parser()
    options = parser.parse_args(words)
    if not hasattr(options, "run"):
        parser.print_help(sys.stderr)
        return WRONG_INPUT
    module, function = options.run
    try:
        return int(getattr(importlib.import_module(module), function)(options))
    except CommandError as error:
        failure = error
    except FileNotFoundError as error:
        failure = CommandError(f"{error.filename or error}: there is no such file", WRONG_INPUT)
    except OSError as error:
        failure = CommandError(str(error), WRONG_INPUT)
    except Exception as error:
        library, problem = _missing_library(error), _ros_problem(error)
        if library:
            failure = CommandError(library, FAILED)
        elif problem:
            failure = CommandError(problem, WRONG_INPUT)
        else:
            raise
    say(str(failure))
    if options.json:
        write_json({"success": False, "error": str(failure), **failure.details})
    return failure.exit_code


def _missing_library(error: Exception) -> str:
    """Return how to get what is not installed, where that is an extra that only some words of a command need, or ''."""
    name = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    return f"{name} is not installed; install deltacharger[{_EXTRA_OF[name]}]" if name in _EXTRA_OF else ""


def _ros_problem(error: Exception) -> str:
    if "rclpy" not in sys.modules:  # many commands need no ROS, and must not need it to fail
        return ""
    from deltacharger_ros.node_support import ros_problem

    return ros_problem(error)


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command."""
    parser: argparse.ArgumentParser = Parser(
        prog="deltacharger",
        description="Run, try and inspect DeltaCharger, a robot's arm that docks to other robots and charges them.",
        epilog="Exit codes: 0 done, 1 the job failed, 2 wrong usage or input, 130 interrupted. "
        "Simulated scenes use ROS_DOMAIN_ID=87 on this machine only, unless ROS_DOMAIN_ID and "
        "ROS_AUTOMATIC_DISCOVERY_RANGE are set.",
    )
    parser.add_argument("--version", action=Version, nargs=0, help="print the version")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    _add_up(commands)
    _add_dock(commands)
    _add_undock(commands)
    _add_scene(commands)
    _add_simulate(commands)
    _add_fault(commands)
    _add_doctor(commands)
    _add_calibrate(commands)
    add_reports(commands)
    _add_tactile(commands)
    _add_vision(commands)
    add_campaign(commands)
    _add_namespace(add_replay(commands))
    _add_namespace(add_view(commands))
    return parser


def _add_scene_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--scene", metavar="NAME|FILE", help=f"packaged scene or YAML file (default: {DEFAULT_SCENE})")


def _add_namespace(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--namespace", type=namespace, default="", metavar="NAME", help="of the charger (default: none)"
    )


def _add_up(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = add_command(
        commands,
        "up",
        ("deltacharger_bringup.cli.up", "up"),
        "run a charger in this process until it is stopped; says 'ready' when its actions answer",
    )
    _add_scene_option(parser)
    _add_namespace(parser)
    add_record(parser)
    add_recording(parser)
    add_overrides(parser)


def _add_dock(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = add_command(
        commands,
        "dock",
        ("deltacharger_bringup.cli.dock", "dock"),
        "dock and charge, with the running charger or else with one started for it",
    )
    _add_scene_option(parser)
    _add_namespace(parser)
    for axis in "xyz":
        parser.add_argument(
            f"--{axis}-mm", type=MILLIMETRES, metavar="MM", help=f"electrodes along {axis} of charger_base"
        )
    parser.add_argument("--roll-deg", type=DEGREES, metavar="DEG", help="of the electrodes about z, -90 to 90")
    parser.add_argument("--camera", action="store_true", help="ask the camera even where the scene has coordinates")
    parser.add_argument(
        "--critical-angle-deg", type=POSITIVE, default=0.0, metavar="DEG", help="refuse earlier than the charger would"
    )
    parser.add_argument("--no-charge", action="store_true", help="end at aligned contact")
    parser.add_argument("--hold", action="store_true", help="go on charging until a stop condition or Ctrl-C")
    parser.add_argument("--stop-after-s", type=POSITIVE, default=0.0, metavar="S", help="of charging")
    parser.add_argument("--stop-energy-j", type=POSITIVE, default=0.0, metavar="J", help="delivered")
    parser.add_argument("--deadline-s", type=deadline, default=math.inf, metavar="S", help="cancel after this long")
    parser.add_argument("--request-id", default="", metavar="ID", help="returned in docking_state")
    parser.add_argument(
        "--picture", default=DEFAULT_PICTURE, metavar="FILE", help=f"of the run (default: {DEFAULT_PICTURE})"
    )
    parser.add_argument("--no-picture", action="store_true", help="write none")
    add_record(parser)


def _add_undock(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = add_command(
        commands,
        "undock",
        ("deltacharger_bringup.cli.undock", "undock"),
        "stop charging, let go and retract the arm of the running charger",
    )
    _add_scene_option(parser)
    _add_namespace(parser)
    parser.add_argument("--deadline-s", type=deadline, default=math.inf, metavar="S", help="cancel after this long")
    parser.add_argument("--request-id", default="", metavar="ID", help="returned in docking_state")


def _add_scene(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser("scene", help="list, check or explain scenes", description="Inspect scenes.")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    module = "deltacharger_bringup.cli.scene"
    add_command(actions, "list", (module, "list_scenes"), "name every packaged scene")
    text = "say whether scenes are well-formed, and what is wrong; a node checks its parameters when it starts"
    check = add_command(actions, "check", (module, "check"), text)
    check.add_argument("scenes", nargs="*", metavar="NAME|FILE", help="default: every packaged scene")
    explain = add_command(actions, "explain", (module, "explain"), "show what a scene sets and every key it could set")
    explain.add_argument("scene", nargs="?", default=DEFAULT_SCENE, metavar="NAME|FILE")
    explain.add_argument("--all", action="store_true", help="also the keys that the scene leaves at their default")


def _add_simulate(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = add_command(
        commands,
        "simulate",
        ("deltacharger_bringup.cli.simulate", "simulate"),
        "serve the emulated servos and board of a scene on two ports, without ROS; says 'ready' with their paths",
    )
    _add_scene_option(parser)
    add_simulate(parser)


def _add_fault(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = add_command(
        commands,
        "fault",
        ("deltacharger_bringup.cli.fault", "fault"),
        "let something go wrong with the emulated hardware of a charger that runs",
    )
    add_fault(parser)
    _add_namespace(parser)


def _add_doctor(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = add_command(
        commands,
        "doctor",
        ("deltacharger_bringup.cli.doctor", "doctor"),
        "say what is wrong with this computer, its ports and what is plugged in, and how to mend it",
    )
    _add_scene_option(parser)
    add_doctor(parser)


def _add_calibrate(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser(
        "calibrate", help="fit this one charger's dimensions, camera and pads", description="Calibrate."
    )
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    kinematics = add_command(
        actions,
        "kinematics",
        ("deltacharger_bringup.cli.calibrate_kinematics", "kinematics"),
        "plan and measure poses of the arm, and fit its geometry to them",
    )
    add_kinematics(kinematics)
    _add_namespace(kinematics)
    module = "deltacharger_bringup.cli.calibrate_tactile"
    text = "find gains, dead taxels and constant errors of one rig's pads from dockings at known poses"
    add_tactile_calibration(add_command(actions, "tactile", (module, "tactile"), text))
    text = "find where the camera sits from images of a board on the platform"
    camera = add_command(actions, "camera", ("deltacharger_bringup.cli.calibrate_camera", "camera"), text)
    add_camera(camera)
    _add_namespace(camera)


def _add_tactile(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    text = "simulate tactile data, train and judge classifiers of misalignment"
    parser = commands.add_parser("tactile", help=text, description=text[0].upper() + text[1:] + ".")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    add_tactile(actions)


def _add_vision(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    text = "find electrodes in images"
    parser = commands.add_parser("vision", help=text, description=text[0].upper() + text[1:] + ".")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    add_vision(actions)
