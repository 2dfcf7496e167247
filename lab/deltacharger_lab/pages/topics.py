# SPDX-License-Identifier: Apache-2.0
"""The page docs/topics.md from the nodes and the interface files: python -m deltacharger_lab.pages.topics."""

import contextlib
import re
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rclpy.action.graph import get_action_client_names_and_types_by_node, get_action_server_names_and_types_by_node
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from deltacharger_core.ros.frames import TF, TF_STATIC
from deltacharger_lab.pages.parameters import write_page

PARTS = {".msg": ("",), ".srv": ("Request", "Response"), ".action": ("Goal", "Result", "Feedback")}
_LICENCE = "SPDX-License-Identifier:"
_DECLARATION = re.compile(
    r"(?P<type>\S+)\s+(?P<name>\w+)\s*(?P<constant>=\s*\S+)?\s*(?P<default>[^#=]*)(#\s*(?P<text>.*))?"
)


@dataclass
class Field:
    """One field: its name, type as written, default ('' = the type's own) and comment."""

    name: str
    type: str
    default: str
    text: str


@dataclass
class InterfacePart:
    """One part of an interface, such as an action's goal; a message has one without a name."""

    name: str
    fields: list[Field] = field(default_factory=list)
    constants: list[str] = field(default_factory=list)


@dataclass
class Interface:
    """One interface file: the comment at its head and its parts."""

    name: str
    text: str
    parts: list[InterfacePart]


def read(path: Path) -> Interface:
    """Read an interface file.

    Raises:
        ValueError: a line is not a declaration, or the number of parts does not fit the kind of file.
    """
    names = PARTS[path.suffix]
    pieces = re.split(r"^---$", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    if len(pieces) != len(names):
        raise ValueError(f"{path}: {len(pieces)} parts; a {path.suffix} file has {len(names)}")
    head: list[str] = []
    parts = [_part(path, name, piece, head) for name, piece in zip(names, pieces, strict=True)]
    return Interface(path.stem, " ".join(head), parts)


def _part(path: Path, name: str, piece: str, head: list[str]) -> InterfacePart:
    part = InterfacePart(name)
    for line in filter(str.strip, piece.splitlines()):
        comment = line.strip().removeprefix("#").strip()
        if comment.startswith(_LICENCE):
            continue
        if line.startswith("#"):
            head.append(comment)
        elif line.lstrip().startswith("#"):  # continues the line above
            part.fields[-1].text += f" {comment}"
        else:
            _declare(path, part, line)
    return part


def _declare(path: Path, part: InterfacePart, line: str) -> None:
    found = _DECLARATION.fullmatch(line.strip())
    if found is None:
        raise ValueError(f"{path}: '{line}' declares nothing")
    if found["constant"]:
        part.constants.append(f"{found['name']} {found['constant'].removeprefix('=').strip()}")
    else:
        part.fields.append(Field(found["name"], found["type"], found["default"].strip(), found["text"] or ""))


_EVERY_NODES = ("/parameter_events", "/rosout", "/clock")  # topics that every ROS node has
_EVERY_NODES_TYPES = ("rcl_interfaces", "type_description_interfaces")  # of services that every ROS node has
_OF_TF = "transform_timeout"  # a parameter of every node that reads tf, where tf2_ros is installed
_TRANSFORMS = "tf2_msgs/TFMessage"
_ROOT = Path(__file__).parents[3]
_FOLDERS = {"msg": "Messages", "srv": "Services", "action": "Actions"}
_NOTICED = 10.0  # s for a node to notice a subscriber
_WHILE_SUBSCRIBED = "kinematics_node"  # subscribes only then; here the recorder subscribes all the time
_HEAD = """# Topics, services, actions

The endpoints of each node, read from running nodes, and every field of the package's messages, services and actions,
from `msg/`, `srv/` and `action/`. Names are relative, so a second charger needs only a namespace; names with a leading
/ are absolute. Entries marked *while looking* exist only while a client requests the electrodes, *while subscribed*
only while a client subscribes to the node's topics. Nodes subscribe to /tf and /tf_static if tf2_ros is installed,
electrode_detector_node only with mount_from_tf. Mock nodes have the topics and services of the nodes that they
replace. A subscriber that requests reliable delivery receives nothing from a best-effort topic.
"""


@dataclass(frozen=True, order=True)
class Endpoint:
    """One end of a topic, service or action: the node's role, name, type and quality of service."""

    verb: str
    name: str
    type: str
    quality: str = ""


_HEARD_OF_TF = {
    Endpoint("subscribes to", TF, _TRANSFORMS, "reliable, depth 100"),
    Endpoint("subscribes to", TF_STATIC, _TRANSFORMS, "reliable, depth 100, transient local"),
}
_VERBS = ("publishes", "subscribes to", "serves", "calls", "serves the action", "calls the action")


def endpoints(node: Node) -> set[Endpoint]:
    """Return a running node's present endpoints, without those of every ROS node."""
    found = {
        Endpoint(verb, _relative(node, each.topic_name), _type(each.msg_type), quality(each.qos_profile))
        for verb, those in (("publishes", node.publishers), ("subscribes to", node.subscriptions))
        for each in those
        if each.topic_name not in (*_EVERY_NODES, TF, TF_STATIC)
    }
    if node.has_parameter(_OF_TF):
        found |= _HEARD_OF_TF
    found |= {
        Endpoint("serves", _relative(node, each.service_name), _type(each.srv_type))
        for each in node.services
        if not _type(each.srv_type).startswith(_EVERY_NODES_TYPES)
    }
    found |= {
        Endpoint("calls", _relative(node, each.service_name), _type(each.srv_type))
        for each in node.clients
        if "/_action/" not in each.service_name
    }
    name, namespace = node.get_name(), node.get_namespace()
    servers = get_action_server_names_and_types_by_node(node, name, namespace)
    clients = get_action_client_names_and_types_by_node(node, name, namespace)
    played = {each.topic_name for each in node.publishers}  # a player of an action's topics does not serve it
    heard = {each.topic_name for each in node.subscriptions}  # a subscriber to its goals does not call it
    servers = [each for each in servers if f"{each[0]}/_action/feedback" not in played]
    clients = [each for each in clients if f"{each[0]}/_action/feedback" not in heard]
    for verb, actions in (("serves the action", servers), ("calls the action", clients)):
        found |= {Endpoint(verb, _relative(node, each), kinds[0].replace("/action", "")) for each, kinds in actions}
    return found


def quality(profile: QoSProfile) -> str:
    """Return a quality of service in words."""
    words = "best effort" if profile.reliability == ReliabilityPolicy.BEST_EFFORT else "reliable"
    latched = ", transient local" if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL else ""
    return f"{words}, depth {profile.depth}{latched}"


def everything(nodes: Iterable[Node]) -> tuple[dict[str, set[Endpoint]], dict[str, set[Endpoint]]]:
    """Return each running node's endpoints of all times, and those at rest, in the order of names."""
    ordered = sorted(nodes, key=lambda node: node.get_name())
    _wait_until_subscribed(ordered, _WHILE_SUBSCRIBED)
    at_rest = {node.get_name(): endpoints(node) for node in ordered}
    with _looking(ordered):
        return {node.get_name(): endpoints(node) for node in ordered}, at_rest


def document(nodes: Iterable[Node]) -> str:
    """Return the complete page for running nodes, in the order of their names."""
    all_of_them, at_rest = everything(nodes)
    sections = [_HEAD, _overview(all_of_them)]
    sections += [_section(name, found, at_rest[name]) for name, found in all_of_them.items()]
    for folder, title in _FOLDERS.items():
        sections.append(f"## {title}\n")
        sections += [_interface(read(path)) for path in sorted((_ROOT / folder).glob(f"*.{folder}"))]
    return "\n".join(sections)


@contextlib.contextmanager
def _looking(nodes: Iterable[Node]) -> Iterator[None]:
    """Start the detector, and wait until the simulated camera has noticed."""
    by_name: dict[str, Any] = {node.get_name(): node for node in nodes}
    with by_name["electrode_detector_node"]._camera.watching():
        _wait_until_subscribed(by_name.values(), "simulated_camera_node")
        yield


def _wait_until_subscribed(nodes: Iterable[Node], name: str) -> None:
    (node,) = (each for each in nodes if each.get_name() == name)
    end = time.monotonic() + _NOTICED
    while not any(each.verb == "subscribes to" for each in endpoints(node)):
        if time.monotonic() > end:
            raise TimeoutError(f"{name} did not notice its subscriber")
        time.sleep(0.02)


def _overview(found: dict[str, set[Endpoint]]) -> str:
    lines = ["## Topics between nodes", "", "| topic | from | to |", "|---|---|---|"]
    ends = {each.name for those in found.values() for each in those if each.quality}
    topics = sorted(name for name in ends if "/_action/" not in name)
    for topic in topics:
        sources, sinks = (
            ", ".join(node for node, those in found.items() if any((e.verb, e.name) == (verb, topic) for e in those))
            for verb in ("publishes", "subscribes to")
        )
        lines.append(f"| {topic} | {sources or '–'} | {sinks or '–'} |")
    return "\n".join([*lines, ""])


def _section(name: str, found: set[Endpoint], at_rest: set[Endpoint]) -> str:
    lines = [f"## {name}", "", "| | name | type | quality of service |", "|---|---|---|---|"]
    for each in sorted(found, key=lambda each: (_VERBS.index(each.verb), each.name)):
        remark = "" if each in at_rest else " *while looking*"
        if name == _WHILE_SUBSCRIBED and each.verb == "subscribes to":
            remark = " *while subscribed*"
        lines.append(f"| {each.verb} | {each.name} | {_linked(each.type)} | {each.quality}{remark} |")
    return "\n".join([*lines, ""])


def _interface(interface: Interface) -> str:
    parts = [_part_text(part) for part in interface.parts]
    return "\n".join([f"### {interface.name}", "", interface.text, "", *parts])


def _part_text(part: InterfacePart) -> str:
    lines = [f"{part.name}:", ""] if part.name else []
    if part.fields:
        lines += ["| field | type | meaning |", "|---|---|---|"]
        for each in part.fields:
            default = f" (default {each.default})" if each.default else ""
            text = each.text.replace("|", "\\|")
            lines.append(f"| {each.name} | {_linked(each.type)} | {text}{default} |")
    else:
        lines.append("nothing" if not part.constants else "constants alone")
    if part.constants:
        lines += ["", f"Constants: {', '.join(part.constants)}."]
    return "\n".join([*lines, ""])


def _linked(kind: str) -> str:
    """Return a type, as a link if it is one of the package's own."""
    name = kind.removeprefix("deltacharger/").removesuffix("[]")
    known = any((_ROOT / folder / f"{name}.{folder}").exists() for folder in _FOLDERS)
    return f"[{name}](#{name.lower()})" if known else kind


def _type(kind: Any) -> str:
    return f"{kind.__module__.split('.')[0]}/{kind.__name__}"


def _relative(node: Node, name: str) -> str:
    return name.removeprefix(f"{node.get_namespace().rstrip('/')}/") if node.get_namespace() != "/" else name


if __name__ == "__main__":
    raise SystemExit(write_page(document, "topic_table"))
