# SPDX-License-Identifier: Apache-2.0
"""The policies of SROS 2 in config/security, from the nodes: python -m deltacharger_lab.pages.policies config/security.

Each node has a profile of exactly what it publishes, subscribes to, serves and calls, and an enclave. A charger in one
process has one enclave; so have fleet managers, and persons who calibrate.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path

from rclpy.node import Node

from deltacharger_bringup.records import arm_client, charger
from deltacharger_bringup.records.replay.record import Recorder
from deltacharger_core.ros.client import ChargerClient, Guest
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_lab.pages import parameters, topics

FOLDER = Path(__file__).parents[3] / "config" / "security"
_GRANTS = {
    "publishes": ("topics", "publish", "topic"),
    "subscribes to": ("topics", "subscribe", "topic"),
    "serves": ("services", "reply", "service"),
    "calls": ("services", "request", "service"),
    "serves the action": ("actions", "execute", "action"),
    "calls the action": ("actions", "call", "action"),
}
_INCLUDE = 'xmlns:xi="http://www.w3.org/2001/XInclude"'
_LICENCE = "<!-- SPDX-License-Identifier: Apache-2.0 -->"
_PARAMETERS = ["describe_parameters", "get_parameter_types", "get_parameters", "list_parameters", "set_parameters"]
_EVERY_NODES = {
    topics.Endpoint("publishes", "/parameter_events", ""),
    topics.Endpoint("subscribes to", "/parameter_events", ""),
    topics.Endpoint("publishes", "/rosout", ""),
    topics.Endpoint("subscribes to", "/clock", ""),
    *(topics.Endpoint("serves", f"~/{name}", "") for name in (*_PARAMETERS, "set_parameters_atomically")),
    topics.Endpoint("serves", "~/get_type_description", ""),
}
_FLEET = "fleet"
_WORKSHOP = "workshop"
_ASKED = ("servo_node/get", "servo_node/list", "tactile_node/get", "tactile_node/list")
_TUNED = ("docking_node",)
_ON_DEMAND = {  # by the workshop's commands and people
    *(topics.Endpoint("calls", f"{each}_parameters", "") for each in _ASKED),
    *(topics.Endpoint("calls", f"{each}/set_parameters{how}", "") for each in _TUNED for how in ("", "_atomically")),
}


def documents(nodes: Iterable[Node]) -> dict[str, str]:
    """Return the text of each file by its name, from running nodes."""
    running = list(nodes)
    found, _ = topics.everything(running)
    everywhere: set[topics.Endpoint] = set().union(*found.values())
    readable = {topics.Endpoint("subscribes to", each.name, "") for each in everywhere if _is_topic(each)}
    goals = {topics.Endpoint("calls the action", each.name, "") for each in everywhere if _is_goal(each)}
    context, namespace = running[0].context, running[0].get_namespace()
    fleet = readable | goals | _of(ChargerClient(namespace, context), Recorder(context, namespace))
    arm, recording = (
        arm_client.ArmClient(context, DeltaGeometry(), namespace),
        charger.RecordingCharger(context, namespace),
    )
    workshop = fleet | _of(arm, recording) | _ON_DEMAND
    profiles = {**found, _FLEET: fleet, _WORKSHOP: workshop}
    files = {f"{name}.xml": _profile(name, ends) for name, ends in profiles.items()}
    files["every_node.xml"] = _document(f"<profile>\n{_grants(_EVERY_NODES)}</profile>\n")
    return {**files, "policy.xml": _policy(sorted(profiles), sorted({*found, _FLEET}))}


def _is_topic(each: topics.Endpoint) -> bool:
    return each.verb == "publishes" and "/_" not in each.name


def _is_goal(each: topics.Endpoint) -> bool:
    return each.verb == "serves the action" and not each.name.startswith("/")


def _of(*guests: Guest) -> set[topics.Endpoint]:
    """Return the endpoints of some commands' programs."""
    found: set[topics.Endpoint] = set()
    for guest in guests:
        with guest:
            found |= topics.endpoints(guest.node)
    return found


def _profile(name: str, found: set[topics.Endpoint]) -> str:
    common = '  <xi:include href="every_node.xml" xpointer="xpointer(/profile/*)"/>\n'
    return _document(f'<profile ns="/" node="{name}" {_INCLUDE}>\n{common}{_grants(found)}</profile>\n')


def _grants(found: set[topics.Endpoint]) -> str:
    lines = []
    for verb, (group, permission, element) in _GRANTS.items():
        names = sorted({each.name for each in found if each.verb == verb})
        if names:
            lines.append(f'  <{group} {permission}="ALLOW">')
            lines += [f"    <{element}>{name}</{element}>" for name in names]
            lines.append(f"  </{group}>")
    return "".join(f"{line}\n" for line in lines)


def _policy(names: Iterable[str], own: Iterable[str]) -> str:
    enclaves: Mapping[str, Iterable[str]] = {**{name: [name] for name in names}, "charger": own}
    lines = [f'<policy version="0.2.0" {_INCLUDE}>', "  <enclaves>"]
    for name, profiles in sorted(enclaves.items()):
        lines.append(f'    <enclave path="/deltacharger/{name}">')
        lines.append("      <profiles>")
        lines += [f'        <xi:include href="{each}.xml"/>' for each in profiles]
        lines += ["      </profiles>", "    </enclave>"]
    return _document("\n".join([*lines, "  </enclaves>", "</policy>", ""]))


def _document(text: str) -> str:
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{_LICENCE}\n{text}'


def _write(nodes: Iterable[Node]) -> None:
    for name, text in documents(nodes).items():
        (FOLDER / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(parameters.with_every_node(_write, "policies"))
