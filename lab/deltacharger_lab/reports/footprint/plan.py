# SPDX-License-Identifier: Apache-2.0
"""Plan of the footprint report: scenes, durations, repeats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from deltacharger_lab.reports.footprint.start import WAYS
from deltacharger_ros.outcomes import Pose
from deltacharger_scenes.scene import Scene, SceneError, SceneGoal, load_scene, packaged_scenes

_NEEDS = {
    "camera_node": ("replay", "an OAK-D camera"),
    "recording_player_node": ("file", "a recording, which every docking writes"),
}
"""For nodes that need more than a port: the parameter that replaces it, and its description."""


@dataclass(frozen=True)
class FootprintPlan:
    """One report.

    Attributes:
        scenes: to measure, by name.
        left_out: reason for each scene that is not measured.
        ways: of starting.
        repeats: of each scene and way.
        settle_s: after the start, before anything is measured.
        rest_s: duration of the measurement at rest.
        docking_limit_s: after which a docking counts as failed.
        quick: whether it is the short plan.
    """

    scenes: dict[str, Scene]
    left_out: dict[str, str] = field(default_factory=dict)
    ways: tuple[str, ...] = WAYS
    repeats: int = 3
    settle_s: float = 3.0
    rest_s: float = 15.0
    docking_limit_s: float = 120.0
    quick: bool = False


def make_plan(names: Sequence[str] = (), quick: bool = False, repeats: int | None = None) -> FootprintPlan:
    """Return the plan.

    Args:
        names: of packaged scenes, or YAML files; none takes all packaged ones.
        quick: once and shorter.
        repeats: of each scene and way; None = as planned.

    Raises:
        SceneError: a requested scene does not exist or is refused.
    """
    scenes, left_out = {}, {}
    for name in names or packaged_scenes():
        try:
            scene = load_scene(name)
        except SceneError as error:
            if names:
                raise
            left_out[name] = str(error)
            continue
        reason = missing(scene)
        if reason:
            left_out[scene.name] = reason
        else:
            scenes[scene.name] = scene
    if quick:
        return FootprintPlan(scenes, left_out, repeats=repeats or 1, settle_s=1.0, rest_s=3.0, quick=True)
    return FootprintPlan(scenes, left_out, repeats=repeats or 3)


def missing(scene: Scene) -> str:
    """Return what a scene needs beyond emulators; '' for nothing."""
    for node, (parameter, what) in _NEEDS.items():
        if node in scene.nodes and not scene.parameters.get(node, {}).get(parameter):
            return f"{node} needs {what}"
    return ""


def electrodes(scene: Scene) -> Pose | None:
    """Return the pose of the electrodes in a scene's goal; None if its camera finds them.

    A scene on hardware gets the emulated target of the scene `simulated`, at the pose of its goal.
    """
    goal: SceneGoal | None = load_scene("simulated").goal if scene.touches_hardware else scene.goal
    return None if goal is None else Pose(goal.x, goal.y, goal.z, goal.roll)
