# SPDX-License-Identifier: Apache-2.0
"""What the executables of setup.cfg run: the main of a node, which hears signals before it is even imported.

Its import takes a second, in which a Ctrl-C would end it by a traceback.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from functools import partial

from deltacharger_core import signals
from deltacharger_scenes.node_table import NODES

_OTHERS = {"passive_joints_node": "deltacharger_records.view.passive_joints_node"}  # no part of a scene
MODULES = {name: spec.module for name, spec in NODES.items()} | _OTHERS
"""Where the main of each is."""


def __getattr__(name: str) -> Callable[[], int]:
    """Return what runs the node of this name."""
    if name not in MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return partial(_run, MODULES[name])


def _run(module: str) -> int:
    signals.listen()
    return int(importlib.import_module(module).main())
