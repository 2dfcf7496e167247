# SPDX-License-Identifier: Apache-2.0
"""What a scene starts, which libraries that loads, what it computes, what it leaves out, and why.

All of it follows from the scene, the table of nodes, the parameters' own bounds and the import statements of the parts.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

from deltacharger_core.parameters import declaration
from deltacharger_scenes.imports import Libraries, libraries
from deltacharger_scenes.node_table import NODES
from deltacharger_scenes.scene import Scene

COMPOSITION = "deltacharger_scenes.composition"
CHARGER = "deltacharger_sim.charger.simulated_charger"
_CHARGER_NAME = "simulated charger"
_PLACES = ("target",)  # groups of the world whose zeros are places, not effects that are off
WITH_RCLPY = frozenset({"action_msgs", "ament_index_python"})
"""Libraries that some part names and rclpy loads in any case, so that no scene does without them."""

Entry = dict[str, Any]


def describe_parts(scene: Scene) -> dict[str, Any]:
    """Return what the scene is made of.

    Returns:
        parts: what starts, in its order: name, module, imports, imports_when_used and why;
        imports: libraries loaded at the start; imports_when_used: those that some function loads, with its modules;
        computes: groups of the simulated world with what they are;
        left_out: nodes, libraries and effects that this scene does without: kind, name and why.
    """
    started = dict(_started(scene))
    modules = [COMPOSITION, *started.values()]
    whole = _libraries(modules)
    return {
        "parts": [_part(scene, name, module) for name, module in started.items()],
        "imports": sorted(whole.at_once),
        "imports_when_used": whole.when_used,
        "computes": list(_groups(scene)),
        "left_out": [*_left_out_nodes(scene), *_left_out_libraries(started, whole), *_left_out_effects(scene)],
    }


def _started(scene: Scene) -> Iterator[tuple[str, str]]:
    """Yield name and module of every part that the scene starts, in the order of starting."""
    if scene.simulation is not None:
        yield _CHARGER_NAME, CHARGER
    for name in scene.start_order():
        yield name, NODES[name].module


def _libraries(modules: list[str]) -> Libraries:
    return libraries(modules, apart=[CHARGER])


def _part(scene: Scene, name: str, module: str) -> Entry:
    found = _libraries([module])
    return {
        "name": name,
        "module": module,
        "imports": sorted(found.at_once),
        "imports_when_used": found.when_used,
        "why": _why_started(scene, name),
    }


def _why_started(scene: Scene, name: str) -> str:
    if name == _CHARGER_NAME:
        return "the scene has the key 'simulation': emulated servos and board before one simulated world"
    double = NODES[name].stands_in_for
    if NODES[name].port and scene.simulation is not None:
        return "listed in 'nodes'; its port is the simulated charger's"
    if NODES[name].plays:
        return f"listed in 'nodes'; plays from a recording what {', '.join(NODES[name].plays)} said"
    return f"listed in 'nodes'; stands in for {double}" if double else "listed in 'nodes'"


def _groups(scene: Scene) -> Iterator[Entry]:
    """Yield the groups of the simulated world's parameters, each with what it models."""
    if scene.simulation is None:
        return
    world = scene.simulation.world
    for item in dataclasses.fields(world):
        group = getattr(world, item.name)
        if dataclasses.is_dataclass(group):
            about = (type(group).__doc__ or "").strip().splitlines()[0]
            off = [name for name, _ in _zeros(group, item.name)]
            yield {"name": f"simulation.world.{item.name}", "doc": about, "off": off}


def _zeros(group: Any, name: str) -> Iterator[tuple[str, str]]:
    """Yield the numbers of a group that are 0 where 0 is the least that is allowed, with their descriptions."""
    if name in _PLACES:
        return
    for item in dataclasses.fields(group):
        about = declaration(item)
        if about is not None and about.low == 0.0 and getattr(group, item.name) == 0.0:
            yield item.name, about.text


def _left_out_nodes(scene: Scene) -> Iterator[Entry]:
    for name, spec in NODES.items():
        if name in scene.nodes:
            continue
        doubles = [other for other in scene.nodes if NODES[other].replaces(name)]
        doubled = [other for other in scene.nodes if spec.replaces(other)]
        why = f"not listed in 'nodes': {spec.lacks}" if spec.lacks else "not listed in 'nodes'"
        if doubles:
            how = "plays what it said" if name in NODES[doubles[0]].plays else "stands in for it"
            why = f"{doubles[0]} {how}"
        elif doubled:
            why = f"{doubled[0]} itself is there"
        yield {"kind": "node", "name": name, "why": why}
    if scene.simulation is None:
        yield {"kind": "node", "name": _CHARGER_NAME, "why": "the scene has no key 'simulation'"}


def _left_out_libraries(started: dict[str, str], whole: Libraries) -> Iterator[Entry]:
    """Yield the libraries that only parts load which this scene does not start."""
    users: dict[str, list[str]] = {}
    for name, module in ((_CHARGER_NAME, CHARGER), *((name, spec.module) for name, spec in NODES.items())):
        if name not in started:
            found = _libraries([module])
            for library in {*found.at_once, *found.when_used}:
                users.setdefault(library, []).append(name)
    for library in sorted(set(users) - whole.at_once - set(whole.when_used) - WITH_RCLPY):
        yield {"kind": "library", "name": library, "why": f"only for {', '.join(users[library])}"}


def _left_out_effects(scene: Scene) -> Iterator[Entry]:
    if scene.simulation is None:
        return
    world = scene.simulation.world
    for item in dataclasses.fields(world):
        group = getattr(world, item.name)
        if not dataclasses.is_dataclass(group):
            continue
        for name, doc in _zeros(group, item.name):
            yield {"kind": "effect", "name": f"simulation.world.{item.name}.{name}", "why": f"is 0: {doc}"}
    if not world.target.present:
        yield {"kind": "effect", "name": "simulation.world.target", "why": "present is false: nothing to dock to"}
    if not scene.simulation.faults:
        yield {"kind": "effect", "name": "simulation.faults", "why": "none is listed: the hardware stays healthy"}


def tell_parts(found: dict[str, Any]) -> str:
    """Return what `describe_parts` found as lines for people."""
    lines = ["starts, in this order:"]
    for part in found["parts"]:
        lines.append(f"  {part['name']}: {part['why']}")
    lines.append(f"loads: {', '.join(found['imports'])}")
    for library, modules in found["imports_when_used"].items():
        lines.append(f"loads {library} only when used, by {', '.join(modules)}")
    for group in found["computes"]:
        off = f"; off: {', '.join(group['off'])}" if group["off"] else ""
        lines.append(f"computes {group['name']}: {group['doc']}{off}")
    lines.append("leaves out:")
    lines += [f"  {entry['kind']} {entry['name']}: {entry['why']}" for entry in found["left_out"]]
    return "\n".join(lines)
