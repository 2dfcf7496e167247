# SPDX-License-Identifier: Apache-2.0
"""Scenes: a YAML file defines the parts of a charger and their parameters; arguments change it.

A scene without the key `simulation` runs on real hardware. Parts that a scene does not need are not started. Every key
is checked on loading. An unknown key is refused with the nearest known name, a value out of range with the range; the
message always names file and key.
"""

import dataclasses
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from deltacharger_bringup.scenes.node_table import NODES, load
from deltacharger_core import environment, frames, machine, yaml_file
from deltacharger_core.files import brief, given_path
from deltacharger_core.parameters import (
    Bounded,
    ParameterError,
    choice,
    declared,
    did_you_mean,
    from_mapping,
    number,
    words,
)
from deltacharger_sim.charger.simulation import Simulation, target_numbers
from deltacharger_sim.parameters import LITHIUM_7S, WorldParameters

SIMULATED_TARGET = {
    "target_profiles": ["lithium_7s"],
    **{f"lithium_7s.{key}": value for key, value in LITHIUM_7S.items()},
}
"""Parameters of docking_node: the profile of a simulated or mock target, unless the scene has `target_profiles`."""
_WITH_SERVOS = ("servo_node", "kinematics_node", "docking_node")
_OF_SERVOS = ("servo_stiffness", "torque_constant")
"""Parameters that a node with a `servos_file` takes from that file."""


def followed(node: str, world: WorldParameters, parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the parameters of a node that follow the world.

    A position gain in servo_node's parameters scales the servos' stiffness.

    Args:
        node: its executable's name.
        world: of the scene.
        parameters: of each node, as the scene sets them.
    """
    if node not in _WITH_SERVOS:
        return {}
    found: dict[str, Any] = {"torque_constant": world.servo.torque_constant}
    if node != "servo_node":
        found["gravity"] = [world.gravity_x, world.gravity_y, world.gravity_z]
    if node == "docking_node":
        gain = parameters.get("servo_node", {}).get("position_p_gain", machine.POSITION_P_GAIN)
        share = gain / machine.POSITION_P_GAIN if isinstance(gain, int) else 1.0
        found |= {"servo_stiffness": world.servo.stiffness * share, "power": "none" if world.circuit.wired else "board"}
    measured = _OF_SERVOS if parameters.get(node, {}).get("servos_file") else ()
    return {name: value for name, value in found.items() if name not in measured}


def servos_apart(nodes: Collection[str], parameters: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    """Yield key and problem of each node whose `servos_file` differs from the first one.

    Gains, stiffness and torque constant must be from one file.

    Args:
        nodes: of the scene.
        parameters: of each, as the scene sets them.
    """
    files = {node: parameters.get(node, {}).get("servos_file", "") for node in _WITH_SERVOS if node in nodes}
    first = next((node for node, file in files.items() if file), "")
    for node, file in files.items():
        if first and file != files[first]:
            yield (
                f"parameters.{node}.servos_file",
                f"is {brief(file)}, but {first}'s is {brief(files[first])}: give {', '.join(files)} the same file",
            )


STANDARD_NODES = ("servo_node", "tactile_node", "kinematics_node", "misalignment_node", "docking_node")
_SUFFIXES = (".yaml", ".yml")
_SECTIONS = ("simulation", "ports", "goal", "parameters")  # an empty one is valid, and present

T = TypeVar("T")
Problems: TypeAlias = Iterator[tuple[str, str]]  # keys with their problems


class SceneError(ValueError):
    """A scene is invalid.

    Attributes:
        file: path of the scene, or the unknown name.
        key: the invalid key with dots, e.g. simulation.world.servo.stiffness; empty for the complete file.
        problem: what is wrong and what to write.
    """

    def __init__(self, file: str, key: str, problem: str) -> None:
        self.file = file
        self.key = key
        self.problem = problem
        super().__init__(": ".join(part for part in (file, key, problem) if part))


@dataclass(frozen=True)
class SceneGoal(Bounded):
    """Coordinates in place of a camera, in charger_base."""

    x: float = number(0.0, -0.3, 0.3, "m", "midpoint of the electrodes")
    y: float = number(0.0, -0.3, 0.3, "m", "midpoint of the electrodes, +y up")
    z: float = number(
        machine.DOCK_DISTANCE, -0.1, 0.5, "m", "midpoint of the electrodes, +z from the robot to the target"
    )
    roll: float = number(0.0, -1.5708, 1.5708, "rad", "of the electrodes about z, from +x to +y")


@dataclass(frozen=True)
class Ports(Bounded):
    """Serial ports of a scene on real hardware; simulated scenes need none."""

    servo: str = words("", "of the servo adapter, e.g. /dev/ttyUSB0")
    board: str = words("", "of the board with pads and power stage, e.g. /dev/ttyACM0")


@dataclass(frozen=True)
class SceneContent(Bounded):
    """The keys of a scene's file.

    Attributes:
        simulation: the simulated charger; None = real hardware (or mocks, which need no simulation).
        ports: serial ports on real hardware.
        goal: replaces the camera; None = use the camera.
        parameters: of each node by its executable's name.
    """

    name: str = words("", "of the scene")
    description: str = words("", "one or two sentences for people")
    nodes: tuple[str, ...] = words(STANDARD_NODES, "executables to start")
    simulation: Simulation | None = None
    ports: Ports = field(default_factory=Ports)
    goal: SceneGoal | None = None
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    network: str = choice("localhost", ("localhost", "subnet"), "range of its topics: this computer, or its network")


@dataclass(frozen=True)
class Scene(SceneContent):
    """One scene.

    Attributes:
        file: path of the source.
    """

    file: str = ""

    @property
    def touches_hardware(self) -> bool:
        """Whether one of its nodes opens a port of real hardware."""
        return self.simulation is None and any(NODES[name].port for name in self.nodes)

    @property
    def docks(self) -> bool:
        """Whether it has the actions dock and undock."""
        return "docking_node" in self.nodes

    @property
    def _simulates_a_target(self) -> bool:
        """Whether the target that it charges is simulated or a mock."""
        powered = self.simulation is not None and not self.simulation.world.circuit.wired
        return powered or any(NODES[name].stands_in_for == "tactile_node" for name in self.nodes)

    def start_order(self) -> list[str]:
        """Return the nodes in start order; commanding nodes start last and close first."""
        return sorted(self.nodes, key=list(NODES).index)

    def node_parameters(self, name: str, ports: Mapping[str, str]) -> dict[str, Any]:
        """Return the parameters of one node.

        Args:
            name: executable of the node.
            ports: "servo" and "board" of a simulated charger; empty = the scene's own.
        """
        parameters = {key: _of_one_kind(value) for key, value in self.parameters.get(name, {}).items()}
        if self.simulation is not None:
            parameters = followed(name, self.simulation.world, self.parameters) | parameters
        if name == "docking_node" and self._simulates_a_target and "target_profiles" not in parameters:
            parameters = SIMULATED_TARGET | parameters
        if NODES[name].sees_target and self.simulation is not None:
            target = self.simulation.world.target
            parameters = {"target": target_numbers(target), "target_present": target.present} | parameters
        if NODES[name].takes_scene_name:
            parameters = {"scene": self.name} | parameters
        port = NODES[name].port
        path = (ports.get(port) or getattr(self.ports, port)) if port else ""
        return {"port": path, **parameters} if path else parameters


def packaged_scenes() -> dict[str, Path]:
    """Return the file of every packaged scene by name: of the source tree if this is one, else of the installation."""
    return {path.stem: path for folder in environment.config("scenes")[:1] for path in sorted(folder.glob("*.yaml"))}


def find_file(name_or_file: str | Path, packaged: Mapping[str, Path], kind: str = "scene") -> Path:
    """Return a file by path, or by the name of a packaged one of this kind.

    Raises:
        SceneError: there is no such file.
    """
    path, name = Path(name_or_file), str(name_or_file)
    if path.suffix in _SUFFIXES or len(path.parts) > 1:
        if not path.is_file():
            raise SceneError(str(path), "", "there is no such file")
        return path
    if name not in packaged:
        near, there = did_you_mean(name, packaged), ", ".join(packaged) or "none"
        raise SceneError(name, "", f"no packaged {kind} has this name{near}: give one of {there}, or a YAML file")
    return packaged[name]


def read_file(path: Path, parse: Callable[[Any, str, str], T]) -> T:
    """Read a YAML file and build a scene from its content, its name and its path.

    Raises:
        SceneError: it cannot be read, is not YAML, or `parse` rejects a key or value.
    """
    try:
        return parse(yaml_file.read_yaml(path), path.stem, str(path))
    except yaml_file.YamlError as error:
        raise SceneError(error.file, "", error.problem) from error
    except OSError as error:
        raise SceneError(str(path), "", f"cannot be read: {error}") from error
    except ParameterError as error:
        raise SceneError(str(path), error.key, error.problem) from error


def load_scene(name_or_file: str | Path) -> Scene:
    """Read and check a scene.

    Args:
        name_or_file: name of a packaged scene, or path of a YAML file.

    Raises:
        SceneError: it does not exist, is not YAML, or has an invalid key or value.
    """
    return read_file(find_file(name_or_file, packaged_scenes()), parse_scene)


def parse_scene(content: Any, name: str, file: str = "") -> Scene:
    """Build a scene from the content of a YAML file.

    Args:
        content: the mapping.
        name: used if the mapping has no `name`.
        file: for messages.

    Raises:
        SceneError, ParameterError: a key or value is invalid.
    """
    if not isinstance(content, Mapping):
        kind = "empty" if content is None else f"a {type(content).__name__}"
        raise SceneError(file, "", f"is {kind}: give keys and values")
    given = {key: {} if value is None and key in _SECTIONS else value for key, value in content.items()}
    checked = from_mapping({"name": name, **given}, SceneContent)
    values = {"description": " ".join(checked.description.split()), "parameters": _flat(checked.parameters)}
    scene = Scene(**{**vars(checked), **values, "file": file})
    for check in (_nodes, _simulation, _parameters, _ports):
        for key, problem in check(scene):
            raise SceneError(file, key, problem)
    return scene


def _flat(parameters: Any) -> Any:
    """Return nodes' parameters with dotted names in place of nested mappings, as ROS reads them."""
    if not isinstance(parameters, Mapping):
        return parameters
    return {name: _dotted(values) if isinstance(values, Mapping) else values for name, values in parameters.items()}


def _dotted(values: Mapping[Any, Any]) -> dict[Any, Any]:
    found: dict[Any, Any] = {}
    for key, value in values.items():
        nested = isinstance(value, Mapping) and value
        found |= {f"{key}.{inner}": each for inner, each in value.items()} if nested else {key: value}
    return found


def _nodes(scene: Scene) -> Problems:
    for index, name in enumerate(scene.nodes):
        key = f"nodes[{index}]"
        if name not in NODES:
            yield key, f"unknown node {brief(name)}{did_you_mean(name, NODES)}; known: {', '.join(NODES)}"
        if name in scene.nodes[:index]:
            yield key, f"'{name}' is listed twice"
        for other in scene.nodes:
            if other in NODES and (NODES[name].stands_in_for == other):
                yield key, f"'{name}' and '{other}' serve the same names: keep one of them"


def _simulation(scene: Scene) -> Problems:
    if scene.simulation is None:
        return
    try:
        scene.simulation.geometry()
    except OSError as error:
        yield "simulation.geometry_file", f"'{error.filename}' cannot be read: {error.strerror}"
    except ValueError as error:
        yield "simulation.geometry_file", str(error)


def _parameters(scene: Scene) -> Problems:
    if not isinstance(scene.parameters, Mapping):
        yield "parameters", f"{brief(scene.parameters)} is not a mapping of keys to values"
    for name, values in scene.parameters.items():
        key = f"parameters.{name}"
        if name not in scene.nodes:
            near = did_you_mean(name, scene.nodes)
            yield key, f"this scene starts no such node{near}: it starts {', '.join(scene.nodes)}"
        if not isinstance(values, Mapping):
            yield key, "give parameters and values"
        for each, value in values.items():
            if not _is_parameter(value):
                yield f"{key}.{each}", f"is {brief(value)}: give a number, true or false, text, or a list of one type"


def _is_parameter(value: Any) -> bool:
    items = value if isinstance(value, list) else [value]
    kinds = {type(item) for item in items}
    return kinds <= {int, float} or (len(kinds) == 1 and kinds <= {bool, str})


def _of_one_kind(value: Any) -> Any:
    """Return a parameter in ROS's types: a list of whole and other numbers becomes all floats."""
    mixed = isinstance(value, list) and {type(item) for item in value} == {int, float}
    return list(map(float, value)) if mixed else value


def _ports(scene: Scene) -> Problems:
    if scene.simulation is not None and scene.ports != Ports():
        yield "ports", "excludes 'simulation', which has its own ports: keep one of them"
    for index, name in enumerate(scene.nodes):
        port, own = NODES[name].port, scene.parameters.get(name, {}).get("port")
        if NODES[name].sees_target and scene.touches_hardware:
            there = f"'{name}' shows a simulated target, and real servos would move there: keep one of them"
            yield f"nodes[{index}]", there
        if port and scene.simulation is not None and own is not None:
            remedy = "remove it, or the key 'simulation'"
            yield f"parameters.{name}.port", f"a simulated scene must not open a port of real hardware; {remedy}"
        if port and scene.touches_hardware and not (getattr(scene.ports, port) or own):
            remedy = "e.g. /dev/ttyUSB0; or add 'simulation: {}'"
            yield f"ports.{port}", f"'{name}' needs a port on real hardware, {remedy}"


_OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")


def tables(node: str) -> list[type[Any]]:
    """Return the classes that declare the parameters of a node, by its executable's name."""
    return [load(path) for path in NODES[node].parameters]


def problems(scene: Scene) -> Iterator[tuple[str, str]]:
    """Yield key and problem of each parameter that its node would reject, the first of each class of parameters."""
    for node in scene.parameters:
        values = scene.node_parameters(node, {})
        names, entry = _named(node, values)
        sections = [("", table) for table in tables(node)] + [(f"{name}.", entry) for name in names]
        known = {before + each.name: (before, table) for before, table in sections for each in declared(table)}
        given: dict[tuple[str, type[Any]], dict[str, Any]] = {section: {} for section in sections if section[0]}
        for name, value in values.items():
            if name in known:
                before, table = known[name]
                given.setdefault((before, table), {})[name.removeprefix(before)] = value
            elif not name.startswith(_OF_ROS):
                yield f"parameters.{node}.{name}", f"unknown parameter{did_you_mean(name, known)}"
        for (before, table), own in given.items():
            try:
                from_mapping(own, table, f"parameters.{node}.{before}".rstrip("."))
            except ParameterError as error:
                yield error.key, error.problem


def _named(node: str, values: Mapping[str, Any]) -> tuple[list[str], type[Any]]:
    """Return the names that a node's parameter lists, and the class that declares the parameters of each."""
    parameter, entry = NODES[node].named
    names = values.get(parameter, [])
    if not parameter or not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        return [], object
    return names, load(entry)


RECORDER = "docking_recorder_node"
CAMERAS = ("oak", "topics", "none")
_TRUE = ("true", "1", "yes", "on")
_FALSE = ("false", "0", "no", "off")
_SEEING = ("camera_node", "electrode_detector_node")


@dataclass(frozen=True)
class Overrides:
    """Arguments that replace values of a scene; launch arguments have these names with a prefix."""

    servo_port: str = words("", "serial port of the servos, in place of the scene's")
    board_port: str = words("", "serial port of the board, in place of the scene's")
    camera: str = words(
        "", "source of electrode poses: oak = an OAK-D, topics = a camera with its own driver, none = no camera"
    )
    model: str = words("", "pose model (npz) of misalignment_node")
    frame_prefix: str = words("", "prefix of every frame name of the charger, as robot_state_publisher's parameter")
    joint_prefix: str = words("", "prefix of the names in joint_states: the prefix of the URDF's macro")
    record: str = words("", "keep a record of each docking in this folder; true = default folder, false = none")


def override(scene: Scene, arguments: Overrides) -> Scene:
    """Return the scene with the given arguments in place of its own values.

    Raises:
        SceneError: an argument does not fit the scene, or names a missing file; `key` is its name.
    """
    scene = _with_camera(scene, arguments.camera)
    for port in ("servo", "board"):
        scene = _with_port(scene, port, getattr(arguments, f"{port}_port"))
    scene = _with_model(scene, arguments.model)
    return _with_prefixes(_with_record(scene, arguments.record), arguments)


def _with_port(scene: Scene, port: str, path: str) -> Scene:
    if not path:
        return scene
    key = f"{port}_port"
    if scene.simulation is not None:
        raise SceneError(
            scene.file, key, "a simulated scene has its own ports: leave it out, or choose a scene on hardware"
        )
    nodes = [name for name in scene.nodes if NODES[name].port == port]
    if not nodes:
        raise SceneError(scene.file, key, f"no node of this scene opens it; the scene starts {', '.join(scene.nodes)}")
    if not Path(path).exists():
        raise SceneError(scene.file, key, f"'{path}': there is no such port; `deltacharger doctor` lists all ports")
    parameters = dict(scene.parameters)
    for name in nodes:  # a node's own parameter would override the scene's ports
        parameters[name] = {key: value for key, value in parameters.get(name, {}).items() if key != "port"}
    ports = dataclasses.replace(scene.ports, **{port: path})
    return dataclasses.replace(scene, ports=ports, parameters=parameters)


def _with_camera(scene: Scene, camera: str) -> Scene:
    if not camera:
        return scene
    if camera not in CAMERAS:
        raise SceneError(scene.file, "camera", f"is '{camera}': give {', '.join(CAMERAS)}, or leave it out")
    wanted = {"oak": _SEEING, "topics": _SEEING[1:], "none": ()}[camera]
    gone = {name for name in scene.nodes if {name, NODES[name].stands_in_for} & set(_SEEING)} - set(wanted)
    scene = _without(scene, gone)
    nodes = (*scene.nodes, *(name for name in wanted if name not in scene.nodes))
    return dataclasses.replace(scene, nodes=nodes)


def _with_model(scene: Scene, file: str) -> Scene:
    if not file:
        return scene
    if "misalignment_node" not in scene.nodes:
        problem = "this scene starts no misalignment_node: leave it out, or choose a scene with one"
        raise SceneError(scene.file, "model", problem)
    path = given_path(file).absolute()
    if not path.exists():
        raise SceneError(scene.file, "model", f"'{file}': there is no such file")
    return _with_parameter(scene, "misalignment_node", "model", str(path))


def _with_prefixes(scene: Scene, arguments: Overrides) -> Scene:
    """Return the scene with the prefixes of frames and joints in every node that uses them."""
    try:
        given = frames.JointFrameParameters(arguments.frame_prefix, arguments.joint_prefix)
    except ParameterError as error:
        raise SceneError(scene.file, error.key, error.problem) from error
    for name in scene.nodes:
        known = {each.name for table in tables(name) for each in declared(table)}
        for key in ("frame_prefix", "joint_prefix"):
            if (prefix := getattr(given, key)) and key in known:
                scene = _with_parameter(scene, name, key, prefix)
    return scene


def _with_record(scene: Scene, record: str) -> Scene:
    if record and given_path(record).is_file():
        raise SceneError(scene.file, "record", f"'{record}' is a file: give a folder, true or false")
    if record and record.lower() not in (*_TRUE, *_FALSE):
        try:
            folder = given_path(record)
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
        except OSError as error:
            problem = f"'{record}' cannot be written ({error.strerror}): give another folder"
            raise SceneError(scene.file, "record", problem) from error
    return with_recorder(scene, record)


def with_recorder(scene: Scene, folder: str | None) -> Scene:
    """Return the scene with docking_recorder_node, or unchanged if `folder` is None.

    Args:
        scene: to extend.
        folder: of the records; "true" = the scene's or the node's default, "false" = no recorder.
    """
    if not folder:
        return scene
    if folder.lower() in _FALSE:
        return _without(scene, {RECORDER})
    if RECORDER not in scene.nodes:
        scene = dataclasses.replace(scene, nodes=(*scene.nodes, RECORDER))
    if folder.lower() in _TRUE:
        return scene
    return _with_parameter(scene, RECORDER, "folder", str(given_path(folder).absolute()))


def recorder_alone(scene: Scene, folder: str) -> Scene:
    """Return a scene that starts docking_recorder_node only, beside a running charger of `scene`."""
    return with_recorder(dataclasses.replace(scene, nodes=(), simulation=None, parameters={}), folder)


def _with_parameter(scene: Scene, node: str, name: str, value: str) -> Scene:
    own = {**scene.parameters.get(node, {}), name: value}
    return dataclasses.replace(scene, parameters={**scene.parameters, node: own})


def _without(scene: Scene, names: set[str]) -> Scene:
    """Return the scene without these nodes and their parameters."""
    parameters = {name: values for name, values in scene.parameters.items() if name not in names}
    nodes = tuple(name for name in scene.nodes if name not in names)
    return dataclasses.replace(scene, nodes=nodes, parameters=parameters)
