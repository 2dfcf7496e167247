# SPDX-License-Identifier: Apache-2.0
"""Entry points of the executables in setup.cfg: handle signals before anything else is imported.

The imports take a second; without this, Ctrl-C in that second would end in a traceback.
"""

import importlib
import sys
from collections.abc import Callable

from deltacharger_core import signals


def __getattr__(name: str) -> Callable[[], int]:
    """Return the entry point of the node with this name, which is looked up when it runs."""
    if not name.endswith("_node"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return lambda: _run(name)


def modules() -> dict[str, str]:
    """Return the module with the main of each executable."""
    from deltacharger_bringup.scenes.node_table import NODES

    others = {"passive_joints_node": "deltacharger_bringup.records.view.passive_joints_node"}  # not part of a scene
    return {name: spec.module for name, spec in NODES.items()} | others


def _run(name: str) -> int:
    signals.end_at_once(lambda number: 0)
    from deltacharger_core import environment, streams

    if problem := environment.problem():
        streams.write(f"cannot start: {problem}", sys.stderr)
        return 2
    return int(importlib.import_module(modules()[name]).main())
