# SPDX-License-Identifier: Apache-2.0
"""The `deltacharger` command. Each subcommand has a module with its options.

Exit codes: 0 done, 1 the job failed, 2 wrong usage or input, 130 interrupted. With `--json` exactly one JSON object
is written to stdout. Progress and logs are always written to stderr.
"""

import argparse
import importlib
import signal
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import FrameType

from deltacharger_bringup.cli import output
from deltacharger_bringup.cli.arguments import Parser, Version, add_command
from deltacharger_core import streams
from deltacharger_core.environment import UnsupportedRos

Command = tuple[str, str]
"""Its function with the module, relative to this package where it begins with a dot, and what it does."""
COMMANDS: dict[str, Command] = {
    "up": (".charger.up", "run a charger until it is stopped; 'ready' when it accepts goals"),
    "dock": (".dock.dock", "dock and charge; starts a charger if none runs"),
    "undock": (".dock.undock", "stop charging, release the target, retract the arm"),
    "scene": (".scene.scene", "list, check and explain scenes"),
    "simulate": (".simulate.simulate", "emulate a scene's servos and board on two ports, without ROS"),
    "fault": (".simulate.fault", "inject a fault into the emulated hardware"),
    "doctor": (".doctor.doctor", "check computer, ports and devices; say how to correct them"),
    "calibrate": ("", "measure this charger's dimensions, servos, camera and pads"),
    "calibrate kinematics": (".calibrate_kinematics.kinematics", "measure poses of the arm, and fit its geometry"),
    "calibrate servos": (".calibrate_servos.servos", "measure stiffness, torque constant, friction and play"),
    "calibrate tactile": (".calibrate_tactile.tactile", "find gains, dead taxels and errors of one rig's pads"),
    "calibrate camera": (".calibrate_camera.camera", "find the camera's pose from images of a board"),
    "tactile": ("", "record the pads of a charger"),
    "tactile record": (".tactile_record.record", "dock at known offsets and record the pads; repeat it to resume"),
    "vision": ("", "find electrodes in images"),
    "vision detect": (".vision.detect", "find a terminal's electrodes in an image or in a recording"),
    "replay": (".replay.replay", "explain and draw a recorded docking, or list recordings"),
    "view": (".view.view", "show a running or recorded charger in 3D"),
}
"""A group of commands has no function."""
LABORATORY = ("campaign", "report")
"""Commands that a laboratory brings, if it is installed."""
HOW_TO_GET_IT = "install the laboratory: `make lab` in a clone of deltacharger, or `pip install` its folder lab"


_EXTRA_OF = {
    "scipy": "deltacharger[calibrate]",
    "matplotlib": "deltacharger[picture]",
    **dict.fromkeys(("sklearn", "torch", "xgboost"), "deltacharger-lab[train]"),
}


def main(
    arguments: Sequence[str] | None = None, commands: Mapping[str, Command] | None = None, prog: str = "deltacharger"
) -> int:
    """Run one command and return its exit code.

    Args:
        arguments: words of the command line; None = this process's own.
        commands: the known ones; None = those of `deltacharger`.
        prog: name of the program.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if arguments is None:
        streams.secure()
        warnings.showwarning = _show_warning
    try:
        run = partial(_run, words, commands, prog)
        code = run() if arguments is not None else _interruptible(words, run)
    except SystemExit as end:  # argparse has printed its help or an error
        code = int(end.code or output.DONE)
    return streams.ended(code)


def _interruptible(words: list[str], run: Callable[[], int]) -> int:
    try:
        signal.signal(signal.SIGINT, _interrupt)  # until the command, imported later, handles signals
        return run()
    except KeyboardInterrupt:
        if "--as-node" in words:  # nodes then end with 0
            return output.DONE
        return output.show(output.CommandError("interrupted", output.INTERRUPTED).result(), "--json" in words)
    finally:
        if signal.getsignal(signal.SIGINT) is _interrupt:  # nothing catches it while the interpreter ends
            signal.signal(signal.SIGINT, signal.SIG_DFL)


def _show_warning(message: Warning | str, *where: object, **more: object) -> None:
    output.log_line(f"warning: {message}")


def _interrupt(number: int, frame: FrameType | None) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second one must not stop the clean-up
    raise KeyboardInterrupt


def _run(words: list[str], commands: Mapping[str, Command] | None, prog: str) -> int:
    Parser.wants_json = "--json" in words
    options = argparse.Namespace(json=Parser.wants_json)
    try:
        if commands is None:
            commands = COMMANDS if words and words[0] in COMMANDS else every_command()
            _require_laboratory(words, commands)
        parser = build_parser(commands, prog)
        parser.parse_args(words, options)
        if not hasattr(options, "run"):
            parser.print_help(sys.stderr)
            return output.WRONG_INPUT
        result: output.Result = options.run(options)
    except output.CommandError as error:
        result = error.result()
    except UnsupportedRos as error:  # its message is already printed
        result = output.Result(details={"error": str(error)}, code=output.WRONG_INPUT)
    except OSError as error:
        result = output.from_os_error(error).result()
    except UnicodeError as error:
        text = f"a name or text is not UTF-8 ({error}); rename or change it"
        result = output.WrongInput(text).result()
    except Exception as error:
        known = _known(error)
        if known is None:
            raise
        result = known.result()
    return output.show(result, options.json)


def _require_laboratory(words: list[str], commands: Mapping[str, Command]) -> None:
    """Refuse a command of the laboratory where that is not installed, and say how to get it."""
    for name in LABORATORY:
        if name not in commands and words[:1] == [name]:
            raise output.WrongInput(f"{name} is a command of the laboratory: {HOW_TO_GET_IT}")


def _known(error: Exception) -> output.CommandError | None:
    """Return an error that names the missing library or what ROS refuses; None for a defect."""
    name = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    if name == "cv2":  # its message says how to install it; FAILED would mean that no electrodes were found
        return output.WrongInput(str(error))
    if name in _EXTRA_OF:
        others = ", or by rosdep with DELTACHARGER_EXTRAS=all" if name == "scipy" else ""  # what a robot needs
        return output.CommandError(f"{name} is not installed; install {_EXTRA_OF[name]}{others}")
    if "rclpy" in sys.modules:  # commands without ROS must not import it only to report an error
        from deltacharger_core.ros.client import ClientError
        from deltacharger_core.ros.node_support import ros_problem

        if isinstance(error, ClientError):
            return output.CommandError(str(error))
        problem = ros_problem(error)
        return output.WrongInput(problem) if problem else None
    return None


def every_command() -> dict[str, Command]:
    """Return the commands of this package, and those of the laboratory if it is installed."""
    from importlib.metadata import entry_points  # here, because it takes 30 ms

    found = dict(COMMANDS)
    for each in entry_points(group="deltacharger.commands"):
        found |= each.load()
    return found


def build_parser(known: Mapping[str, Command], prog: str = "deltacharger") -> argparse.ArgumentParser:
    """Return the parser of `deltacharger` with these commands."""
    parser: argparse.ArgumentParser = Parser(
        prog=prog,
        description="A robot arm that docks to other robots and charges them.",
        epilog="Exit codes: 0 done, 1 the job failed, 2 wrong usage or input, 130 interrupted. Simulated scenes use "
        "ROS_DOMAIN_ID=87 and this machine only, unless ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE are set.",
    )
    parser.add_argument("--version", action=Version, nargs=0, help="print the version")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    groups: dict[str, argparse._SubParsersAction[argparse.ArgumentParser]] = {"": commands}
    for name, (where, text) in known.items():
        group, _, action = name.rpartition(" ")
        if where:
            add_command(groups[group], action, text, partial(_fill, where))
        elif name not in groups:
            own = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
            groups[name] = own.add_subparsers(title="actions", metavar="ACTION", required=True)
    return parser


def _fill(where: str, parser: argparse.ArgumentParser) -> None:
    """Import a command's module only when it is used, and add the options by its `add_…` function."""
    name, _, function = where.rpartition(".")
    module = importlib.import_module(name, __package__)
    add = getattr(module, f"add_{function}", None)  # a command may have no options
    if add is not None:
        add(parser)
    parser.set_defaults(run=getattr(module, function))
