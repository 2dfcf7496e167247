"""Scenes with the recorder of dockings: added to others, or by itself beside a charger that runs."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from deltacharger_bringup.scene import Scene

RECORDER = "docking_recorder_node"


def with_recorder(scene: Scene, folder: str | None) -> Scene:
    """Return the scene with docking_recorder_node, which writes to `folder`; as it is where that is empty."""
    if not folder:
        return scene
    own = {**scene.parameters.get(RECORDER, {}), "folder": str(Path(folder).expanduser().absolute())}
    nodes = scene.nodes if RECORDER in scene.nodes else (*scene.nodes, RECORDER)
    return dataclasses.replace(scene, nodes=nodes, parameters={**scene.parameters, RECORDER: own})


def recorder_alone(scene: Scene, folder: str) -> Scene:
    """Return a scene that starts docking_recorder_node and nothing else, beside a charger of `scene` that runs."""
    return with_recorder(dataclasses.replace(scene, nodes=(), simulation=None, parameters={}), folder)
