# SPDX-License-Identifier: Apache-2.0
"""What a scene starts, which libraries that loads, what it computes, what it leaves out, and why.

All of it follows from the scene, the table of nodes and the parameters' own bounds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

from deltacharger_core.parameters import declaration
from deltacharger_scenes.node_table import CHARGER, NODES, NodeSpec
from deltacharger_scenes.scene import Scene

_CHARGER_NAME = "simulated charger"
_EVERYWHERE = ("numpy", "rclpy")
_PLACES = ("target",)  # groups of the world whose zeros are places, not effects that are off

Entry = dict[str, Any]


def describe_parts(scene: Scene) -> dict[str, Any]:
    """Return what the scene is made of.

    Returns:
        parts: what starts, in its order: name, module, imports, imports_when_used and why;
        imports: libraries loaded at the start; imports_when_used: those that some function loads, with its parts;
        computes: groups of the simulated world with what they are;
        left_out: nodes, libraries and effects that this scene does without: kind, name and why.
    """
    started = dict(_started(scene))
    at_once = set().union(*(spec.needs for spec in started.values()))
    when_used = _users(started, at_once=False)
    return {
        "parts": [_part(scene, name, spec) for name, spec in started.items()],
        "imports": [*_EVERYWHERE, *sorted(at_once)],
        "imports_when_used": {name: users for name, users in when_used.items() if name not in at_once},
        "computes": list(_computed(scene)),
        "left_out": [*_left_out_nodes(scene), *_left_out_libraries(started), *_left_out_effects(scene)],
    }


def _started(scene: Scene) -> Iterator[tuple[str, NodeSpec]]:
    """Yield every part with its name that the scene starts, in the order of starting."""
    if scene.simulation is not None:
        yield _CHARGER_NAME, CHARGER
    for name in scene.start_order():
        yield name, NODES[name]


def _users(parts: Mapping[str, NodeSpec], *, at_once: bool = True) -> dict[str, list[str]]:
    """Return the libraries that parts need when used, or at once as well, each with the parts."""
    users: dict[str, list[str]] = {}
    for name, spec in parts.items():
        for library in (*(spec.needs if at_once else ()), *spec.needs_when_used):
            users.setdefault(library, []).append(name)
    return dict(sorted(users.items()))


def _part(scene: Scene, name: str, spec: NodeSpec) -> Entry:
    return {
        "name": name,
        "module": spec.module,
        "imports": [*_EVERYWHERE, *spec.needs],
        "imports_when_used": list(spec.needs_when_used),
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


def _groups(scene: Scene) -> Iterator[tuple[str, Any]]:
    """Yield name and values of the groups of the simulated world's parameters."""
    if scene.simulation is not None:
        for item in dataclasses.fields(scene.simulation.world):
            group = getattr(scene.simulation.world, item.name)
            if dataclasses.is_dataclass(group):
                yield item.name, group


def _computed(scene: Scene) -> Iterator[Entry]:
    """Yield the groups, each with what it models."""
    for name, group in _groups(scene):
        about = (type(group).__doc__ or "").strip().splitlines()[0]
        yield {"name": f"simulation.world.{name}", "doc": about, "off": [each for each, _ in _zeros(group, name)]}


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


def _left_out_libraries(started: Mapping[str, NodeSpec]) -> Iterator[Entry]:
    """Yield the libraries that only parts load which this scene does not start."""
    there = _users(started)
    for library, users in _users({_CHARGER_NAME: CHARGER, **NODES}).items():
        if library not in there:
            yield {"kind": "library", "name": library, "why": f"only for {', '.join(users)}"}


def _left_out_effects(scene: Scene) -> Iterator[Entry]:
    for group, values in _groups(scene):
        for name, doc in _zeros(values, group):
            yield {"kind": "effect", "name": f"simulation.world.{group}.{name}", "why": f"is 0: {doc}"}
    if scene.simulation is None:
        return
    if not scene.simulation.world.target.present:
        yield {"kind": "effect", "name": "simulation.world.target", "why": "present is false: nothing to dock to"}
    if not scene.simulation.faults:
        yield {"kind": "effect", "name": "simulation.faults", "why": "none is listed: the hardware stays healthy"}


def tell_parts(found: dict[str, Any]) -> str:
    """Return what `describe_parts` found as lines for people."""
    lines = ["starts, in this order:"]
    for part in found["parts"]:
        lines.append(f"  {part['name']}: {part['why']}")
    lines.append(f"loads: {', '.join(found['imports'])}")
    for library, parts in found["imports_when_used"].items():
        lines.append(f"loads {library} only when used, by {', '.join(parts)}")
    for group in found["computes"]:
        off = f"; off: {', '.join(group['off'])}" if group["off"] else ""
        lines.append(f"computes {group['name']}: {group['doc']}{off}")
    lines.append("leaves out:")
    lines += [f"  {entry['kind']} {entry['name']}: {entry['why']}" for entry in found["left_out"]]
    return "\n".join(lines)
