# SPDX-License-Identifier: Apache-2.0
"""How a launch file was started: by itself, or included by another; and arguments that it does not know."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterable
from itertools import pairwise
from pathlib import Path

from deltacharger_core.parameters import did_you_mean

_PACKAGE = "deltacharger"
_OF_LAUNCH = ("launch-prefix", "launch-prefix-filter", "emulate_tty", "sigterm_timeout", "sigkill_timeout")


def is_launched_itself(file: str) -> bool:
    """Return whether `ros2 launch` was asked for this launch file, and not for one that includes it.

    It is by its path, or by its package and name: a robot's own launch file may have the same name.
    """
    own = Path(file)
    by_path = any(Path(word).name == own.name and Path(word).resolve() == own.resolve() for word in sys.argv)
    return by_path or any(pair == (_PACKAGE, own.name) for pair in pairwise(sys.argv))


def refuse_slips(file: str, words: Iterable[str], known: Collection[str]) -> None:
    """Refuse unknown arguments where the launch file was started itself; one that includes it has others of its own.

    Args:
        file: path of the launch file.
        words: arguments that launch was given, as `name:=value`.
        known: arguments that the file declares.

    Raises:
        ValueError: names the argument and the nearest known one.
    """
    if not is_launched_itself(file):
        return
    for word in words:
        name, assigned, _ = word.partition(":=")
        if assigned and name not in known and name not in _OF_LAUNCH:
            raise ValueError(f"unknown argument '{name}'{did_you_mean(name, known)}; known: {', '.join(known)}")
