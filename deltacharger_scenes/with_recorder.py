# SPDX-License-Identifier: Apache-2.0
"""Scenes with the recorder of dockings: added to others, or by itself beside a charger that runs."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from deltacharger_scenes.scene import Scene

RECORDER = "docking_recorder_node"
_TRUE = ("true", "1", "yes", "on")
_FALSE = ("false", "0", "no", "off")


def with_recorder(scene: Scene, folder: str | None) -> Scene:
    """Return the scene with docking_recorder_node, or as it is where nothing is told.

    Args:
        scene: to which it is added.
        folder: where records go; "true" = where the scene or else the node says, "false" = no recorder at all.
    """
    if not folder:
        return scene
    if folder.lower() in _FALSE:
        return without(scene, {RECORDER})
    if folder.lower() in _TRUE:
        return scene if RECORDER in scene.nodes else dataclasses.replace(scene, nodes=(*scene.nodes, RECORDER))
    own = {**scene.parameters.get(RECORDER, {}), "folder": str(Path(folder).expanduser().absolute())}
    nodes = scene.nodes if RECORDER in scene.nodes else (*scene.nodes, RECORDER)
    return dataclasses.replace(scene, nodes=nodes, parameters={**scene.parameters, RECORDER: own})


def without(scene: Scene, names: set[str]) -> Scene:
    """Return the scene without these nodes and their parameters."""
    parameters = {name: values for name, values in scene.parameters.items() if name not in names}
    nodes = tuple(name for name in scene.nodes if name not in names)
    return dataclasses.replace(scene, nodes=nodes, parameters=parameters)


def recorder_alone(scene: Scene, folder: str) -> Scene:
    """Return a scene that starts docking_recorder_node and nothing else, beside a charger of `scene` that runs."""
    return with_recorder(dataclasses.replace(scene, nodes=(), simulation=None, parameters={}), folder)
