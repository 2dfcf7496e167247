# SPDX-License-Identifier: Apache-2.0
"""Parts of a scene: what it starts, loads and computes, what it leaves out, and why.

Everything is derived from the scene, the table of nodes and the parameters' bounds.
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
_PLACES = ("target",)  # groups of the world whose zeros are positions, not disabled effects

Entry = dict[str, Any]


def describe_parts(scene: Scene) -> dict[str, Any]:
    """Return the parts of the scene.

    Returns:
        parts: in start order: name, module, imports, imports_when_used and why;
        imports: libraries loaded at the start; imports_when_used: those loaded by some functions, with the parts;
        computes: groups of the simulated world with descriptions;
        left_out: nodes, libraries and effects not in this scene: kind, name and why.
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
    """Yield every started part with its name, in start order."""
    if scene.simulation is not None:
        yield _CHARGER_NAME, CHARGER
    for name in scene.start_order():
        yield name, NODES[name]


def _users(parts: Mapping[str, NodeSpec], *, at_once: bool = True) -> dict[str, list[str]]:
    """Return the libraries needed when used (and at once, if `at_once`), each with its parts."""
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
        return "the scene has the key 'simulation': emulated servos and board with one simulated world"
    double = NODES[name].stands_in_for
    if NODES[name].port and scene.simulation is not None:
        return "listed in 'nodes'; its port is the simulated charger's"
    if NODES[name].plays:
        return f"listed in 'nodes'; plays the recorded topics of {', '.join(NODES[name].plays)}"
    return f"listed in 'nodes'; replaces {double}" if double else "listed in 'nodes'"


def _groups(scene: Scene) -> Iterator[tuple[str, Any]]:
    """Yield name and values of the groups of the simulated world's parameters."""
    if scene.simulation is not None:
        for item in dataclasses.fields(scene.simulation.world):
            group = getattr(scene.simulation.world, item.name)
            if dataclasses.is_dataclass(group):
                yield item.name, group


def _computed(scene: Scene) -> Iterator[Entry]:
    """Yield the groups, each with its description."""
    for name, group in _groups(scene):
        about = (type(group).__doc__ or "").strip().splitlines()[0]
        yield {"name": f"simulation.world.{name}", "doc": about, "off": [each for each, _ in _zeros(group, name)]}


def _zeros(group: Any, name: str) -> Iterator[tuple[str, str]]:
    """Yield a group's numbers that are 0, with 0 as their lower bound, and their descriptions."""
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
            how = "plays its recorded topics" if name in NODES[doubles[0]].plays else "replaces it"
            why = f"{doubles[0]} {how}"
        elif doubled:
            why = f"{doubled[0]} itself is part of the scene"
        yield {"kind": "node", "name": name, "why": why}
    if scene.simulation is None:
        yield {"kind": "node", "name": _CHARGER_NAME, "why": "the scene has no key 'simulation'"}


def _left_out_libraries(started: Mapping[str, NodeSpec]) -> Iterator[Entry]:
    """Yield the libraries loaded only by parts that this scene does not start."""
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
        yield {"kind": "effect", "name": "simulation.world.target", "why": "present is false: no target"}
    if not scene.simulation.faults:
        yield {"kind": "effect", "name": "simulation.faults", "why": "none is listed"}


def parts_text(found: dict[str, Any]) -> str:
    """Return the result of `describe_parts` as lines for people."""
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
