# SPDX-License-Identifier: Apache-2.0
"""How every command parses its arguments: the parser, common options, types of values, and files to read or write."""

from __future__ import annotations

import argparse
import math
import os
import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from deltacharger_bringup.cli import output
from deltacharger_core import environment, streams, texts

DEFAULT_SCENE = "simulated"
_PICTURES = (".png", ".pdf", ".svg", ".jpg", ".jpeg")


class Parser(argparse.ArgumentParser):
    """Parser that also reports wrong usage as JSON if --json is given, and reads `-8e1` as a number.

    Args:
        fill: adds the options when this parser is used.
    """

    wants_json = False

    def __init__(
        self, *arguments: Any, fill: Callable[[argparse.ArgumentParser], None] | None = None, **options: Any
    ) -> None:
        super().__init__(*arguments, **options)
        self._fill = fill
        self._negative_number_matcher = re.compile(r"-(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse the arguments; some may be left over."""
        fill, self._fill = self._fill, None
        if fill is not None:
            fill(self)
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Report what is wrong with the arguments and end with exit code 2."""
        for action in self._actions:
            if action.choices and action.metavar and message.endswith(f"required: {action.metavar}"):
                message += f", one of {', '.join(map(str, action.choices))}"
        message = streams.shortened(message)
        if Parser.wants_json:
            output.show(output.Result(details={"error": message}, code=output.WRONG_INPUT), as_json=True)
        super().error(message)

    def _print_message(self, message: str, file: Any = None) -> None:
        if message:
            streams.write(message, file, end="")


class Version(argparse.Action):
    """Print the installed version, looked up only on request."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        """Print the version and end the process."""
        output.print_text(f"deltacharger {environment.package_version()}")
        parser.exit()


def add_command(
    commands: argparse._SubParsersAction[argparse.ArgumentParser],
    name: str,
    text: str,
    fill: Callable[[argparse.ArgumentParser], None] | None = None,
) -> argparse.ArgumentParser:
    """Add a command or an action with the option `--json`, and return its parser.

    Args:
        commands: to which it is added.
        name: of the command.
        text: what it does.
        fill: as in `Parser`.
    """
    parser = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".", fill=fill)
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    return parser


def scene_option(parser: argparse.ArgumentParser) -> None:
    """Add `--scene` to a command."""
    parser.add_argument("--scene", metavar="NAME|FILE", help=f"packaged scene or YAML file (default: {DEFAULT_SCENE})")


def namespace_option(parser: argparse.ArgumentParser) -> None:
    """Add `--namespace` to a command that communicates with a charger."""
    parser.add_argument(
        "--namespace", type=namespace, default="", metavar="NAME", help="ROS namespace of the charger (default: none)"
    )


def record_option(parser: argparse.ArgumentParser) -> None:
    """Add `--record` to a command that starts a charger."""
    text = "record each docking in this folder (without DIR: the default folder of docking_recorder_node)"
    parser.add_argument("--record", nargs="?", const="true", metavar="DIR", help=text)


def between(low: float, high: float) -> Callable[[str], float]:
    """Return the type of a finite number from `low` to `high`."""

    def number(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"'{text}' is not a number") from None
        if not math.isfinite(value):
            raise argparse.ArgumentTypeError(f"'{text}' is not finite")
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"'{text}' is outside {low:g} to {high:g}")
        return value

    return number


def integer(low: int, high: int) -> Callable[[str], int]:
    """Return the type of a whole number from `low` to `high`."""

    def number(text: str) -> int:
        if not re.fullmatch(r"[-+]?[0-9]{1,12}", text):
            raise argparse.ArgumentTypeError(f"'{text}' is not a whole number")
        if not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(f"'{text}' is outside {low} to {high}")
        return int(text)

    return number


def namespace(text: str) -> str:
    """Return a ROS namespace without its outer slashes; '' means none."""
    name = text.strip("/")
    if name and not all(part.isidentifier() and part.isascii() for part in name.split("/")):
        raise argparse.ArgumentTypeError(f"'{text}' is not a ROS namespace; use letters, digits and _")
    return name


NOT_NEGATIVE = between(0.0, 2e9)  # range of a Duration's seconds
MILLIMETRES = between(-1e3 * texts.ON_ROBOT, 1e3 * texts.ON_ROBOT)
DEGREES = between(-90.0, 90.0)
SEED = integer(0, 2**32 - 1)


def deadline(text: str) -> float:
    """Return seconds; 0 means none, as for the other limits."""
    return NOT_NEGATIVE(text) or math.inf


def file_to_read(flag: str, name: str) -> Path:
    """Return an existing path, which its reader checks; CommandError with exit code 2 if there is none."""
    if not Path(name).exists():
        raise output.WrongInput(f"{flag} {name}: there is no such file")
    return Path(name)


def file_to_write(flag: str, name: str, kind: str = "", overwrite: bool = True) -> Path:
    """Return the path of a file that can be written.

    Args:
        flag: the option that names it.
        name: its value.
        kind: required suffix.
        overwrite: whether it may exist already.

    Raises:
        CommandError: it cannot or must not be written; exit code 2.
    """
    path = Path(name)
    if kind and path.suffix != kind:
        raise output.WrongInput(f"{flag} '{name}': the name must end in {kind}", file=name)
    if not path.parent.is_dir():
        problem = f"{flag} {name}: the folder {path.parent} does not exist; create it"
        raise output.WrongInput(problem, file=name)
    if path.is_dir() or not (os.access(path, os.W_OK) if path.exists() else _takes_files(path.parent)):
        raise output.WrongInput(f"{flag} {name}: cannot be written; give another file", file=name)
    if path.exists() and not overwrite:
        problem = f"{path} exists: choose another name, or overwrite it with --force"
        raise output.WrongInput(problem, file=name)
    return path


def picture_to_write(name: str) -> Path:
    """Return the path of `--picture`, with a suffix that matplotlib supports; errors as in `file_to_write`."""
    if Path(name).suffix.lower() not in _PICTURES:
        raise output.WrongInput(f"--picture '{name}': the name must end in {', '.join(_PICTURES)}", file=name)
    return file_to_write("--picture", name)


def folder_to_write(flag: str, name: str) -> Path:
    """Return a folder, created if missing; errors as in `file_to_write`."""
    folder = Path(name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        code = output.WRONG_INPUT if output.is_wrong_path(error) else output.FAILED
        raise output.CommandError(
            f"{flag} {name}: cannot be a folder ({error.strerror}); give another", code
        ) from error
    if not _takes_files(folder):
        raise output.WrongInput(f"{flag} {name}: the folder is not writable; give another one")
    return folder


def _takes_files(folder: Path) -> bool:
    """Whether a file can be created there. Permissions alone do not show this for root.

    Raises:
        OSError: the disk is full or fails.
    """
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError as error:
        if not output.is_wrong_path(error):
            raise
        return False
