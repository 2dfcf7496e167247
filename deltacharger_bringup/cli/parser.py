# SPDX-License-Identifier: Apache-2.0
"""How every command reads its words and tells a wrong usage."""

from __future__ import annotations

import argparse
import re
from typing import Any, NoReturn

from deltacharger_bringup.cli.output import tell, write_json


class Parser(argparse.ArgumentParser):
    """Tells a wrong usage as the one JSON object too, where the words ask for one, and reads `-8e1` as a number."""

    wants_json = False

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._negative_number_matcher = re.compile(r"-(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$")

    def error(self, message: str) -> NoReturn:
        """Say what is wrong with the words and end with exit code 2."""
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction) and message.endswith(f"required: {action.metavar}"):
                message += f", one of {', '.join(action.choices)}"
        if Parser.wants_json:
            write_json({"success": False, "error": message})
        super().error(message)


class Version(argparse.Action):
    """Print the installed version, looked up only where it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        """Print it and end the process."""
        from importlib.metadata import PackageNotFoundError, version

        try:
            text = version("deltacharger")
        except PackageNotFoundError:  # a colcon workspace
            text = "unknown, not installed with pip"
        tell(f"deltacharger {text}")
        parser.exit()


def add_command(
    commands: argparse._SubParsersAction[argparse.ArgumentParser],
    name: str,
    run: tuple[str, str],
    text: str,
) -> argparse.ArgumentParser:
    """Add a command, or an action of one, with the option that all have, and return its parser.

    Args:
        commands: to which it is added.
        name: as it is called.
        run: module and function that carry it out.
        text: what it does.
    """
    parser = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    parser.set_defaults(run=run)
    return parser
