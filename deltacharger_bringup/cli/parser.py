# SPDX-License-Identifier: Apache-2.0
"""How every command parses its arguments and reports wrong usage."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from typing import Any, NoReturn

from deltacharger_bringup.cli.output import print_text, write_json
from deltacharger_bringup.cli.types import namespace
from deltacharger_core import streams
from deltacharger_core.version import package_version

DEFAULT_SCENE = "simulated"


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
            if isinstance(action, argparse._SubParsersAction) and message.endswith(f"required: {action.metavar}"):
                message += f", one of {', '.join(action.choices)}"
        message = streams.shortened(message)
        if Parser.wants_json:
            write_json({"success": False, "error": message})
        super().error(message)

    def _print_message(self, message: str, file: Any = None) -> None:
        if message:
            streams.write(message, file, end="")


class Version(argparse.Action):
    """Print the installed version, looked up only on request."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        """Print the version and end the process."""
        print_text(f"deltacharger {package_version()}")
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
