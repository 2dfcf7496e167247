# SPDX-License-Identifier: Apache-2.0
"""Entry points of the executables in setup.cfg: handle signals before importing the node.

The import takes a second; without this, Ctrl-C in that second would end in a traceback.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from functools import partial

from deltacharger_core import environment, signals, streams
from deltacharger_scenes.node_table import NODES

_OTHERS = {"passive_joints_node": "deltacharger_records.view.passive_joints_node"}  # not part of a scene
MODULES = {name: spec.module for name, spec in NODES.items()} | _OTHERS
"""Module with the main of each executable."""


def __getattr__(name: str) -> Callable[[], int]:
    """Return the entry point of the node with this name."""
    if name not in MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return partial(_run, MODULES[name])


def _run(module: str) -> int:
    signals.listen()
    if problem := environment.problem():
        streams.write(f"cannot start: {problem}", sys.stderr)
        return 2
    return int(importlib.import_module(module).main())
