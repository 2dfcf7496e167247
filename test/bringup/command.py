# SPDX-License-Identifier: Apache-2.0
"""The command `deltacharger`, run in this process."""

import json
import shlex
from collections.abc import Mapping
from typing import Any

import pytest

from deltacharger_bringup.cli.main import Command, main

Capture = pytest.CaptureFixture[str]


def run(capsys: Capture, *words: object, commands: Mapping[str, Command] | None = None) -> tuple[int, str, str]:
    """Return exit code, standard output and standard error; `commands` as in `main`."""
    try:
        code = main(list(map(str, words)), commands)
    except SystemExit as end:  # argparse ends the process itself
        code = int(end.code or 0)
    return code, *capsys.readouterr()


def answer(
    capsys: Capture, *words: object, commands: Mapping[str, Command] | None = None
) -> tuple[int, dict[str, Any]]:
    """Return exit code and JSON object."""
    code, out, _ = run(capsys, *words, "--json", commands=commands)
    found = json.loads(out)
    assert isinstance(found, dict)
    return code, found


def refuses(
    capsys: Capture,
    line: str,
    noun: str,
    code: int = 2,
    commands: Mapping[str, Command] | None = None,
    **files: object,
) -> dict[str, Any]:
    """Check that a command line ends with this code and noun, writes one object.

    Args:
        capsys: of the test.
        line: the command, with words in {braces} for `files`.
        noun: part of the message.
        code: expected exit code.
        commands: as in `main`.
        files: words of the line.
    """
    words = [word.format(**files) for word in shlex.split(line)]
    ended, out, err = run(capsys, *words, "--json", commands=commands)
    found = json.loads(out)
    assert (ended, found["success"]) == (code, False), (line, out)
    assert noun in found["error"], (line, found["error"])
    assert noun in err, (line, err)
    return dict(found)
