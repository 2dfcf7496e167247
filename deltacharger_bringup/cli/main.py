# SPDX-License-Identifier: Apache-2.0
"""The `deltacharger` command: its commands, options and exit codes; each has a module, with its options.

Exit codes: 0 done, 1 the job failed, 2 wrong usage or input, 130 interrupted. With `--json` exactly one JSON object
goes to stdout; progress and logs always go to stderr.
"""

from __future__ import annotations

import argparse
import importlib
import signal
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from types import FrameType

from deltacharger_bringup.cli.output import FAILED, INTERRUPTED, WRONG_INPUT, CommandError, say, write_json
from deltacharger_bringup.cli.parser import Parser, Version, add_command


@dataclass(frozen=True)
class CommandLine:
    """What a command does, and where: function `name` of `module` carries it out, `add_name` there adds its options."""

    text: str
    module: str
    name: str

    def fill(self, parser: argparse.ArgumentParser) -> None:
        """Import the module, which other commands do not wait for, and add the options."""
        module = importlib.import_module(f"deltacharger_bringup.cli.{self.module}")
        add = getattr(module, f"add_{self.name}", None)  # a command may do without options of its own
        if add is not None:
            add(parser)
        parser.set_defaults(run=getattr(module, self.name))


@dataclass(frozen=True)
class Group:
    """Commands under one name."""

    text: str
    description: str
    actions: dict[str, CommandLine]


COMMANDS: dict[str, CommandLine | Group] = {
    "up": CommandLine(
        "run a charger in this process until it is stopped; says 'ready' when its actions answer", "up", "up"
    ),
    "dock": CommandLine("dock and charge, with the running charger or else with one started for it", "dock", "dock"),
    "undock": CommandLine("stop charging, let go and retract the arm of the running charger", "undock", "undock"),
    "scene": Group(
        "list, check or explain scenes",
        "Inspect scenes.",
        {
            "list": CommandLine("name every packaged scene", "scene", "list_scenes"),
            "check": CommandLine(
                "say whether scenes are well-formed, and what is wrong; a node checks its parameters when it starts",
                "scene",
                "check",
            ),
            "explain": CommandLine("show what a scene sets and every key it could set", "scene", "explain"),
        },
    ),
    "simulate": CommandLine(
        "serve the emulated servos and board of a scene on two ports, without ROS; says 'ready' with their paths",
        "simulate",
        "simulate",
    ),
    "fault": CommandLine("let something go wrong with the emulated hardware of a charger that runs", "fault", "fault"),
    "doctor": CommandLine(
        "say what is wrong with this computer, its ports and what is plugged in, and how to mend it", "doctor", "doctor"
    ),
    "calibrate": Group(
        "fit this one charger's dimensions, camera and pads",
        "Calibrate.",
        {
            "kinematics": CommandLine(
                "plan and measure poses of the arm, and fit its geometry to them", "calibrate_kinematics", "kinematics"
            ),
            "tactile": CommandLine(
                "find gains, dead taxels and constant errors of one rig's pads from dockings at known poses",
                "calibrate_tactile",
                "tactile",
            ),
            "camera": CommandLine(
                "find where the camera sits from images of a board on the platform", "calibrate_camera", "camera"
            ),
        },
    ),
    "report": Group(
        "measure a part and write a page",
        "Measure and report.",
        {
            "kinematics": CommandLine(
                "error against run time of inverse and forward kinematics, extremes, and pictures of the workspace",
                "report",
                "kinematics",
            ),
            "tactile": CommandLine(
                "compare the classifiers of misalignment on simulated data: accuracy, run time, splits, shifts, "
                "confidence",
                "report",
                "tactile",
            ),
            "vision": CommandLine(
                "the electrode detector on simulated images: what it finds, errors, run time, false alarms, both "
                "renderers",
                "report",
                "vision",
            ),
            "simulation": CommandLine(
                "error against run time, stability, energy and extremes of the simulated charger's mechanics",
                "report",
                "simulation",
            ),
            "docking": CommandLine(
                "thousands of simulated dockings: what is charged, refused and never happens; the same call goes on",
                "report",
                "docking",
            ),
            "footprint": CommandLine(
                "what each scene costs a computer: processes, start-up, memory, CPU at rest and docking, libraries "
                "(Linux)",
                "report",
                "footprint",
            ),
        },
    ),
    "tactile": Group(
        "simulate tactile data, train and judge classifiers of misalignment",
        "Simulate tactile data, train and judge classifiers of misalignment.",
        {
            "generate": CommandLine("write a simulated data set", "tactile", "generate"),
            "record": CommandLine(
                "dock the running charger at known offsets and record what the pads feel; the same call goes on",
                "tactile_record",
                "record",
            ),
            "train": CommandLine("train a classifier", "tactile", "train"),
            "evaluate": CommandLine("judge a trained classifier", "tactile", "evaluate"),
            "compare": CommandLine(
                "compare all models on simulated data, the same as `report tactile`", "report", "tactile"
            ),
        },
    ),
    "vision": Group(
        "find electrodes in images",
        "Find electrodes in images.",
        {
            "detect": CommandLine(
                "find a terminal's electrodes in one image, in a folder of images or in a recording", "vision", "detect"
            )
        },
    ),
    "campaign": CommandLine(
        "simulate many dockings in a row, faster than real time and without ROS; the same call goes on",
        "campaign",
        "campaign",
    ),
    "replay": CommandLine(
        "say why a recorded docking ended as it did, and draw it; or list the records in a folder", "replay", "replay"
    ),
    "view": CommandLine(
        "show a running charger or a recording of one: mechanism, camera, pads, currents, states, decisions",
        "view",
        "view",
    ),
}

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
    options = argparse.Namespace(json=Parser.wants_json)
    try:
        parser = build_parser()
        parser.parse_args(words, options)
        if not hasattr(options, "run"):
            parser.print_help(sys.stderr)
            return WRONG_INPUT
        return int(options.run(options))
    except CommandError as error:
        failure = error
    except FileNotFoundError as error:
        failure = CommandError(f"{error.filename or error}: there is no such file", WRONG_INPUT)
    except (PermissionError, IsADirectoryError, NotADirectoryError) as error:  # a path that was given is a wrong one
        failure = CommandError(str(error), WRONG_INPUT)
    except OSError as error:
        failure = CommandError(str(error), FAILED)
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
    for name, command in COMMANDS.items():
        if isinstance(command, CommandLine):
            add_command(commands, name, command.text, command.fill)
            continue
        group = commands.add_parser(name, help=command.text, description=command.description)
        actions = group.add_subparsers(title="actions", metavar="ACTION", required=True)
        for action, one in command.actions.items():
            add_command(actions, action, one.text, one.fill)
    return parser
