# SPDX-License-Identifier: Apache-2.0
"""Changes of a scene by command line or launch file: ports, camera, model, prefixes, recorder.

Every argument is text; empty keeps the scene's value. Arguments that do not fit the scene or name missing files are
refused before anything starts.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deltacharger_core.files import given_path
from deltacharger_core.frames import JointFrameParameters
from deltacharger_core.parameters import ParameterError, declared, did_you_mean, from_mapping, words
from deltacharger_scenes.node_table import NODES, load
from deltacharger_scenes.scene import Scene, SceneError

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
        given = JointFrameParameters(arguments.frame_prefix, arguments.joint_prefix)
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
