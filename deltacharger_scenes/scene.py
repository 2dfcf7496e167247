# SPDX-License-Identifier: Apache-2.0
"""Scenes: one YAML file says which parts of a charger exist and what their parameters are.

A scene without the key `simulation` runs on real hardware. Nothing that a scene does not need is started. Every key is
checked when the scene is loaded: an unknown one is refused with the nearest known name, a value out of range with the
range, always naming the file and the key.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from deltacharger_core import environment
from deltacharger_core.machine import DOCK_DISTANCE
from deltacharger_core.parameters import Bounded, ParameterError, from_mapping, number, words
from deltacharger_core.yaml_file import YamlError, read_yaml
from deltacharger_scenes.following import followed
from deltacharger_scenes.node_table import NODES
from deltacharger_sim.charger.simulation import Simulation

STANDARD_NODES = ("servo_node", "tactile_node", "kinematics_node", "misalignment_node", "docking_node")
_SUFFIXES = (".yaml", ".yml")


class SceneError(ValueError):
    """A scene is refused.

    Attributes:
        file: path of the scene, or the name that no scene has.
        key: the offending key with dots, e.g. simulation.world.servo.stiffness; empty where it is the file as a whole.
        problem: what is wrong and what to write instead.
    """

    def __init__(self, file: str, key: str, problem: str) -> None:
        self.file = file
        self.key = key
        self.problem = problem
        super().__init__(": ".join(part for part in (file, key, problem) if part))


@dataclass(frozen=True)
class SceneGoal(Bounded):
    """Coordinates that stand in for the camera, in charger_base."""

    x: float = number(0.0, -0.3, 0.3, "m", "midpoint of the electrodes")
    y: float = number(0.0, -0.3, 0.3, "m", "midpoint of the electrodes, +y up")
    z: float = number(DOCK_DISTANCE, -0.1, 0.5, "m", "midpoint of the electrodes, +z from the robot to the target")
    roll: float = number(0.0, -1.5708, 1.5708, "rad", "of the electrodes about z, from +x to +y")


@dataclass(frozen=True)
class Ports(Bounded):
    """Serial ports of a scene on real hardware; a simulated scene needs none."""

    servo: str = words("", "of the servo adapter, e.g. /dev/ttyUSB0")
    board: str = words("", "of the board with pads and power stage, e.g. /dev/ttyACM0")


@dataclass(frozen=True)
class Scene:
    """One scene.

    Attributes:
        name: what it is called.
        description: one or two sentences for people.
        nodes: executables to start.
        simulation: the simulated charger; None = real hardware (or mocks, which need none).
        ports: serial ports on real hardware.
        goal: stands in for the camera; None = ask the camera.
        parameters: of each node by its executable's name.
        file: where it was read from.
    """

    name: str
    description: str = ""
    nodes: tuple[str, ...] = STANDARD_NODES
    simulation: Simulation | None = None
    ports: Ports = field(default_factory=Ports)
    goal: SceneGoal | None = None
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    file: str = ""

    @property
    def touches_hardware(self) -> bool:
        """Whether a node of it opens a port of real hardware."""
        return self.simulation is None and any(NODES[name].port for name in self.nodes)

    @property
    def docks(self) -> bool:
        """Whether it has the actions dock and undock."""
        return "docking_node" in self.nodes

    def start_order(self) -> list[str]:
        """Return the nodes in the order in which they start; who commands comes last, and closes first."""
        return sorted(self.nodes, key=list(NODES).index)

    def node_parameters(self, name: str, ports: Mapping[str, str]) -> dict[str, Any]:
        """Return the parameters of one node.

        Args:
            name: executable of the node.
            ports: "servo" and "board" of a simulated charger; empty takes the scene's own.
        """
        parameters = dict(self.parameters.get(name, {}))
        if self.simulation is not None:
            parameters = followed(name, self.simulation.world) | parameters
        if NODES[name].sees_target and self.simulation is not None:
            target = self.simulation.world.target
            parameters = {f"target_{item.name}": getattr(target, item.name) for item in fields(target)} | parameters
        if NODES[name].told_scene:
            parameters = {"scene": self.name} | parameters
        port = NODES[name].port
        path = (ports.get(port) or getattr(self.ports, port)) if port else ""
        return {"port": path, **parameters} if path else parameters


def scene_folders() -> list[Path]:
    """Return the folders that hold packaged scenes: those of the source tree, then of each installation."""
    return [folder for folder in environment.config("scenes") if folder.is_dir()]


def packaged_scenes() -> dict[str, Path]:
    """Return the file of every packaged scene by name; the first folder that has a name wins."""
    found: dict[str, Path] = {}
    for folder in scene_folders():
        for path in sorted(folder.iterdir()):
            if path.suffix in _SUFFIXES:
                found.setdefault(path.stem, path)
    return found


def find_scene(name_or_file: str | Path) -> Path:
    """Return the file of a scene given by name or by path.

    Raises:
        SceneError: there is none.
    """
    path = Path(name_or_file)
    if path.suffix in _SUFFIXES or len(path.parts) > 1:
        if not path.is_file():
            raise SceneError(str(path), "", "there is no such file")
        return path
    scenes = packaged_scenes()
    if str(name_or_file) in scenes:
        return scenes[str(name_or_file)]
    raise SceneError(
        str(name_or_file),
        "",
        f"no packaged scene has this name{_nearest(str(name_or_file), list(scenes))}; "
        f"there are {', '.join(scenes) or 'none'}, or give a YAML file",
    )


def load_scene(name_or_file: str | Path) -> Scene:
    """Read and check a scene.

    Args:
        name_or_file: name of a packaged scene, or path of a YAML file.

    Raises:
        SceneError: it does not exist, is not YAML, or a key or value in it is refused.
    """
    path = find_scene(name_or_file)
    try:
        content = read_yaml(path)
    except YamlError as error:
        raise SceneError(str(path), "", error.problem) from error
    except OSError as error:
        raise SceneError(str(path), "", f"cannot be read: {error}") from error
    try:
        return parse_scene(content, path.stem, str(path))
    except ParameterError as error:
        raise SceneError(str(path), error.key, error.problem) from error


def parse_scene(content: Any, name: str, file: str = "") -> Scene:
    """Build a scene from what a YAML file contains.

    Args:
        content: the mapping.
        name: taken where the mapping has no `name`.
        file: for messages.

    Raises:
        SceneError, ParameterError: a key or value is refused.
    """
    top = _Level(file, "", content)
    top.only("name", "description", "nodes", "simulation", "ports", "goal", "parameters")
    nodes = _read_nodes(top)
    scene = Scene(
        name=top.text("name", name),
        description=" ".join(top.text("description", "").split()),
        nodes=nodes,
        simulation=_read_simulation(top),
        ports=from_mapping(top.mapping("ports"), Ports, "ports"),
        goal=from_mapping(top.mapping("goal"), SceneGoal, "goal") if top.has("goal") else None,
        parameters=_read_parameters(top, nodes),
        file=file,
    )
    _check_ports(scene)
    return scene


class _Level:
    """One mapping of the file with the key that leads to it."""

    def __init__(self, file: str, key: str, content: Any) -> None:
        self._file = file
        self._key = key
        if not isinstance(content, Mapping):
            kind = "empty" if content is None else f"a {type(content).__name__}"
            raise SceneError(file, key, f"is {kind}; give keys and values")
        self._content = content

    def has(self, key: str) -> bool:
        return key in self._content

    def refuse(self, key: str, problem: str) -> SceneError:
        return SceneError(self._file, f"{self._key}.{key}" if self._key else key, problem)

    def only(self, *known: str) -> None:
        for key in self._content:
            if key not in known:
                raise self.refuse(key, f"unknown key{_nearest(key, known)}; known: {', '.join(known)}")

    def text(self, key: str, default: str) -> str:
        value = self._content.get(key, default)
        if not isinstance(value, str):
            raise self.refuse(key, f"is {value!r}; give text")
        return value

    def raw(self, key: str, default: Any) -> Any:
        return self._content.get(key, default)

    def mapping(self, key: str) -> Mapping[str, Any]:
        value = self._content.get(key)
        return {} if value is None else self.below(key)._content

    def below(self, key: str) -> _Level:
        return _Level(self._file, f"{self._key}.{key}" if self._key else key, self._content[key])


def _read_nodes(top: _Level) -> tuple[str, ...]:
    names = top.raw("nodes", list(STANDARD_NODES))
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise top.refuse("nodes", f"is {names!r}; give a list of executables")
    for index, name in enumerate(names):
        if name not in NODES:
            raise top.refuse(
                f"nodes[{index}]", f"unknown node {name!r}{_nearest(str(name), list(NODES))}; known: {', '.join(NODES)}"
            )
        if name in names[:index]:
            raise top.refuse(f"nodes[{index}]", f"'{name}' is listed twice")
        for other in names:
            if other in NODES and (NODES[name].replaces(other) or _are_doubles(name, other)):
                raise top.refuse(f"nodes[{index}]", f"'{name}' and '{other}' serve the same names; keep one of them")
    return tuple(names)


def _are_doubles(name: str, other: str) -> bool:
    """Return whether one plays what the other stands in for."""
    return bool(NODES[other].stands_in_for) and NODES[other].stands_in_for in NODES[name].plays


def _read_simulation(top: _Level) -> Simulation | None:
    if not top.has("simulation"):
        return None
    simulation = from_mapping(top.mapping("simulation"), Simulation, "simulation")
    try:
        simulation.geometry()
    except OSError as error:
        raise top.refuse("simulation.geometry_file", f"'{error.filename}' cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise top.refuse("simulation.geometry_file", str(error)) from error
    return simulation


def _read_parameters(top: _Level, nodes: Sequence[str]) -> dict[str, dict[str, Any]]:
    level = _Level("", "", top.mapping("parameters"))
    result: dict[str, dict[str, Any]] = {}
    for name in top.mapping("parameters"):
        if name not in nodes:
            raise top.refuse(
                f"parameters.{name}",
                f"this scene starts no such node{_nearest(name, nodes)}; it starts {', '.join(nodes)}",
            )
        values = level.raw(name, None)
        if not isinstance(values, Mapping):
            raise top.refuse(f"parameters.{name}", "give parameters and values")
        for key, value in values.items():
            if not _is_parameter(value):
                raise top.refuse(
                    f"parameters.{name}.{key}",
                    f"is {value!r}; give a number, a truth value, text or a list of one kind",
                )
        result[name] = dict(values)
    return result


def _is_parameter(value: Any) -> bool:
    if isinstance(value, list):
        return len({type(item) for item in value}) <= 1 and all(
            isinstance(item, bool | int | float | str) for item in value
        )
    return isinstance(value, bool | int | float | str)


def _check_ports(scene: Scene) -> None:
    if scene.simulation is not None and scene.ports != Ports():
        raise SceneError(scene.file, "ports", "excludes 'simulation', which brings its own ports; keep one of them")
    for index, name in enumerate(scene.nodes):
        port = NODES[name].port
        if NODES[name].sees_target and scene.touches_hardware:
            raise SceneError(
                scene.file,
                f"nodes[{index}]",
                f"'{name}' shows a simulated target, and real servos would go there; keep one of them",
            )
        if port and scene.simulation is not None and "port" in scene.parameters.get(name, {}):
            raise SceneError(
                scene.file,
                f"parameters.{name}.port",
                "a simulated scene must not open a port of real hardware; remove it, or the key 'simulation'",
            )
        if (
            port
            and scene.touches_hardware
            and not (getattr(scene.ports, port) or scene.parameters.get(name, {}).get("port"))
        ):
            raise SceneError(
                scene.file,
                f"ports.{port}",
                f"'{name}' needs a port on real hardware, e.g. /dev/ttyUSB0; or add 'simulation: {{}}'",
            )


def _nearest(word: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(word, list(known), 1)
    return f", did you mean '{near[0]}'?" if near else ""
