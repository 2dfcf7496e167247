# SPDX-License-Identifier: Apache-2.0
"""The page docs/parameters.md from the declarations: python -m deltacharger_lab.pages.parameters."""

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.node import Node

from deltacharger_core import environment, streams
from deltacharger_core.parameters import Declaration, declared
from deltacharger_core.ros.node_support import ros_problem
from deltacharger_docking.parameters import TargetProfile
from deltacharger_lab.campaigns.keys import FACTS, PARTS, known_keys
from deltacharger_lab.second.parameters import SecondParameters
from deltacharger_sim.parameters import WorldParameters


def sections() -> str:
    """Return the tables of all models and of campaigns, as sections of Markdown."""
    second = [key for key in declared(SecondParameters) if not f"second.{key.name}".startswith(FACTS)]
    parts = tuple(f"{name}." for name in PARTS if name)
    campaigns = [key for name, key in known_keys().items() if not name.startswith(parts)]
    tables = {
        "Target profiles": declared(TargetProfile),
        "Simulated world": declared(WorldParameters),
        "Second contact physics": second,
        "Campaign scenes": campaigns,
    }
    return "\n".join(_table(title, keys) for title, keys in tables.items())


def _table(title: str, keys: Iterable[Declaration]) -> str:
    lines = [f"## {title}", "", "| key | default | allowed | unit | meaning |", "|---|---|---|---|---|"]
    for key in keys:
        default = "must be given" if key.problem(key.default) else text(key.default)
        lines.append(f"| {key.name} | {default} | {_values(key)} | {key.unit} | {key.text} |")
    return "\n".join([*lines, ""])


def _values(key: Declaration) -> str:
    if key.choices:
        return f"one of: {', '.join(key.choices)}"
    return "" if key.kind is bool else f"{key.low:.6g} … {key.high:.6g}"


def text(value: Any) -> str:
    """Return a default in the page's format."""
    if value is None:
        return "none"
    if isinstance(value, str):
        return value or "(empty)"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, bool | int):
        return str(value).lower()
    return ", ".join(text(item) for item in value)


_OWN = ("use_sim_time", "start_type_description_service")  # every ROS node has them
_PER_SCENE = ("port", "file")
_PORT = "set per scene"
_HEAD = """# Parameters

Every parameter of every node, model and campaign, from their declarations. An unknown name or a value outside its
bounds is refused. A node then stops at start with exit code 2 and names the parameter. An unknown name in a section
for all nodes (`/**`) of a ROS parameter file is a warning: it may belong to another node.

Node parameters marked * can be set while the node runs ([tuning](bringup.md#tuning)). All others are fixed.

| section | where its keys stand |
|---|---|
| names of nodes | `parameters: {node: {name: value}}` of a scene |
| [Target profiles](#target-profiles) | `name: {...}` under docking_node, for each name in `target_profiles` |
| [Simulated world](#simulated-world) | `simulation.world` of a scene; `world` of a campaign's scene |
| [Second contact physics](#second-contact-physics) | `second` of a campaign's scene |
| [Campaign scenes](#campaign-scenes) | top level of a campaign's scene |
"""


def table(node: Node) -> str:
    """Return the parameters of a running node as a section of Markdown."""
    lines = [f"## {node.get_name()}", "", "| parameter | default | allowed | meaning |", "|---|---|---|---|"]
    for name in sorted(node.get_parameters_by_prefix("")):
        if name in _OWN or name.startswith("qos_overrides."):
            continue
        descriptor = node.describe_parameter(name)
        default = _PORT if name in _PER_SCENE else text(node.get_parameter(name).value)
        live = "" if descriptor.read_only else " *"
        lines.append(f"| {name}{live} | {default} | {_allowed(descriptor)} | {descriptor.description} |")
    return "\n".join([*lines, ""])


def document(nodes: Iterable[Node]) -> str:
    """Return the page: running nodes in the order of their names, then models and campaigns."""
    tables = [table(node) for node in sorted(nodes, key=lambda node: node.get_name())]
    return "\n".join([_HEAD, *tables, sections()])


def _allowed(descriptor: Any) -> str:
    for bounds in (*descriptor.floating_point_range, *descriptor.integer_range):
        return f"{bounds.from_value:.6g} … {bounds.to_value:.6g}"
    return str(descriptor.additional_constraints)


@contextmanager
def every_node(context: Context, namespace: str) -> Iterator[list[Node]]:
    """Run the nodes of a robot, of its simulation and of its display, each once, and return them."""
    from deltacharger_bringup.records.view.passive_joints_node import PassiveJointsNode
    from deltacharger_bringup.scenes.composition import Composition
    from deltacharger_bringup.scenes.scene import STANDARD_NODES, parse_scene

    others = ("simulated_camera_node", "electrode_detector_node", "mission_node", "docking_recorder_node")
    names = [*STANDARD_NODES, *others]
    unset = {"docking_recorder_node": {"scene": ""}, "docking_node": {"target_profiles": []}}  # by the scene
    scene = parse_scene({"nodes": names, "simulation": {}, "parameters": unset}, "parameters")
    with Composition(scene, context, namespace) as composition, ExitStack() as stack:
        nodes: list[Any] = [spinner.node for spinner in composition.nodes.values()]
        joints = PassiveJointsNode(context=context, namespace=namespace, use_global_arguments=False)
        for node in (_camera(context, namespace), joints):
            stack.callback(node.destroy_node)
            stack.callback(getattr(node, "close", lambda: None))
            nodes.append(node)
        yield nodes


def _camera(context: Context, namespace: str) -> Any:
    from deltacharger_vision.cameras.camera_node import CameraNode
    from deltacharger_vision.cameras.oak_pipeline import CameraUnavailable

    def no_camera(*arguments: Any) -> Any:
        raise CameraUnavailable("only its parameters are read")

    return CameraNode(no_camera, context=context, namespace=namespace, use_global_arguments=False)


def write_page(document: Callable[[list[Node]], str], namespace: str) -> int:
    """Write a page on all nodes to stdout."""
    return with_every_node(lambda nodes: streams.write(document(nodes), sys.stdout, end=""), namespace)


def with_every_node(use: Callable[[list[Node]], object], namespace: str) -> int:
    """Call `use` with all nodes running; the main function of a page."""
    streams.secure()
    environment.prepare()
    environment.isolate()
    context = Context()
    try:
        rclpy.init(context=context, args=[])
    except Exception as error:  # rclpy raises its own kinds
        streams.write(f"cannot start: {ros_problem(error) or error}", sys.stderr)
        return streams.ended(2)
    with every_node(context, namespace) as nodes:
        use(nodes)
    rclpy.try_shutdown(context=context)
    return streams.ended(0)


if __name__ == "__main__":
    raise SystemExit(write_page(document, "parameter_table"))
