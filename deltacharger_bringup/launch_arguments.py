# SPDX-License-Identifier: Apache-2.0
"""Check whether a launch file was started directly or included, and refuse its unknown arguments."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterable
from itertools import pairwise
from pathlib import Path

from deltacharger_core.parameters import did_you_mean

_PACKAGE = "deltacharger"
_OF_LAUNCH = ("launch-prefix", "launch-prefix-filter", "emulate_tty", "sigterm_timeout", "sigkill_timeout")


def is_launched_itself(file: str) -> bool:
    """Return whether `ros2 launch` started this launch file, and not one that includes it.

    The command line must contain its path, or package and name together: another launch file may have the same name.
    """
    own = Path(file)
    by_path = any(Path(word).name == own.name and Path(word).resolve() == own.resolve() for word in sys.argv)
    return by_path or any(pair == (_PACKAGE, own.name) for pair in pairwise(sys.argv))


def refuse_unknown_arguments(file: str, words: Iterable[str], known: Collection[str]) -> None:
    """Refuse unknown arguments if the launch file was started directly; an including file has its own.

    Args:
        file: path of the launch file.
        words: arguments of the command line, as `name:=value`.
        known: declared arguments.

    Raises:
        ValueError: names the argument and the nearest known one.
    """
    if not is_launched_itself(file):
        return
    for word in words:
        name, assigned, _ = word.partition(":=")
        if assigned and name not in known and name not in _OF_LAUNCH:
            raise ValueError(f"unknown argument '{name}'{did_you_mean(name, known)}; known: {', '.join(known)}")
