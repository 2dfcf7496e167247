# SPDX-License-Identifier: Apache-2.0
"""`deltacharger scene list|check|explain`."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import math
from collections.abc import Iterator
from typing import Any

from deltacharger_bringup.cli.output import DONE, WRONG_INPUT, CommandError, log_line, print_text, write_json
from deltacharger_bringup.cli.parser import DEFAULT_SCENE
from deltacharger_core.parameters import Declaration, declaration
from deltacharger_scenes.following import contradictions, servos_apart
from deltacharger_scenes.node_table import NODES
from deltacharger_scenes.parameter_check import problems
from deltacharger_scenes.scene import Scene, SceneError, load_scene, packaged_scenes
from deltacharger_sim.proven import doubts


def add_check(parser: argparse.ArgumentParser) -> None:
    """Add the options of `scene check`."""
    parser.add_argument("scenes", nargs="*", metavar="NAME|FILE", help="default: every packaged scene")


def add_explain(parser: argparse.ArgumentParser) -> None:
    """Add the options of `scene explain`."""
    parser.add_argument("scene", nargs="?", default=DEFAULT_SCENE, metavar="NAME|FILE")
    parser.add_argument("--all", action="store_true", help="also show the keys with default values")


@contextlib.contextmanager
def refusing_scenes(before: str = "") -> Iterator[None]:
    """Report a refused scene with exit code 2, its file and its key; `before` begins the message.

    Raises:
        CommandError: instead of SceneError.
    """
    try:
        yield
    except SceneError as error:
        raise CommandError(f"{before}{error}", WRONG_INPUT, file=error.file, key=error.key) from error


def load_for_command(name_or_file: str) -> Scene:
    """Return the scene; CommandError with exit code 2 if it is refused."""
    with refusing_scenes():
        return load_scene(name_or_file)


def list_scenes(options: argparse.Namespace) -> int:
    """List the packaged scenes with their descriptions."""
    scenes = []
    for name, path in packaged_scenes().items():
        try:
            scene = load_scene(path)
            scenes.append({"name": name, "kind": _kind(scene), "description": scene.description, "file": str(path)})
        except SceneError as error:
            scenes.append({"name": name, "kind": "refused", "description": error.problem, "file": str(path)})
    if options.json:
        write_json({"scenes": scenes})
        return DONE
    width = max((len(entry["name"]) for entry in scenes), default=0)
    for entry in scenes:
        print_text(f"{entry['name']:<{width}}  {entry['kind']:<9}  {entry['description']}")
    return DONE


def check(options: argparse.Namespace) -> int:
    """Load scenes; report the first problem of each, unvalidated values of its world and contradictions."""
    reports = []
    for name in options.scenes or list(packaged_scenes()):
        try:
            scene = load_scene(name)
            wrong = next(problems(scene), None)
            if wrong is not None:
                raise SceneError(scene.file, *wrong)
            warnings = list(_warnings(scene))
            good = {"scene": scene.name, "file": scene.file, "ok": True, "key": "", "problem": "", "warnings": warnings}
            reports.append(good)
            for warning in warnings:
                log_line(f"{scene.file}: warning: {warning}")
        except SceneError as error:
            refused = {"scene": name, "file": error.file, "ok": False, "key": error.key, "problem": error.problem}
            reports.append({**refused, "warnings": []})
            log_line(str(error))
    if options.json:
        write_json({"ok": all(report["ok"] for report in reports), "scenes": reports})
    else:
        for report in reports:
            print_text(f"{report['scene']}: {'ok' if report['ok'] else 'refused'}")
    return DONE if all(report["ok"] for report in reports) else WRONG_INPUT


def _warnings(scene: Scene) -> Iterator[str]:
    """Yield unvalidated values of a simulated world, and parameters that contradict it or each other."""
    for key, problem in servos_apart(scene.nodes, scene.parameters):
        yield f"{key}: {problem}"
    if scene.simulation is not None:
        yield from (f"simulation.world: {doubt}" for doubt in doubts(scene.simulation.world))
        for key, problem in contradictions(scene.parameters, scene.simulation.world):
            yield f"{key}: {problem}"


def explain(options: argparse.Namespace) -> int:
    """Show what a scene sets, starts and cannot do; with --all every possible key."""
    scene = load_for_command(options.scene)
    keys = list(describe(scene))
    shown = keys if options.all or options.json else [key for key in keys if key["set"]]
    lacks = {name: spec.lacks for name, spec in NODES.items() if spec.lacks and not _has(scene, name)}
    if options.json:
        head = {"scene": scene.name, "description": scene.description, "file": scene.file}
        write_json({**head, "keys": shown, "lacks": lacks})
        return DONE
    print_text(f"{scene.name} ({_kind(scene)}): {scene.description}\n{scene.file}\n")
    for key in shown:
        print_text(f"{key['key']} = {_plain(key['value'])}{_unit(key)}")
        about = [text for text in (key["doc"], _range(key), "" if key["set"] else "default") if text]
        if about:
            print_text(f"    {'; '.join(about)}")
    if not options.all:
        print_text(f"\n{len(keys) - len(shown)} more keys have their default; --all shows them.")
    for name, lack in lacks.items():
        print_text(f"without {name}: {lack}")
    return DONE


def _has(scene: Scene, name: str) -> bool:
    """Return whether a scene starts a node or one that replaces it."""
    return any(each == name or NODES[each].replaces(name) for each in scene.nodes)


def describe(scene: Scene) -> Iterator[dict[str, Any]]:
    """Yield every key of a scene: value, unit, range, meaning, and whether it differs from its default."""
    yield _entry("nodes", list(scene.nodes), True, Declaration("nodes", str, (), "executables that it starts"))
    if scene.goal is not None:
        yield from _fields("goal", scene.goal, None)
    if scene.simulation is not None:
        yield from _fields("simulation", scene.simulation, type(scene.simulation)())
    if scene.touches_hardware:
        yield from _fields("ports", scene.ports, type(scene.ports)())
    for node, values in scene.parameters.items():
        for name, value in values.items():
            yield _entry(f"parameters.{node}.{name}", value, True, None)


def _fields(key: str, instance: Any, default: Any) -> Iterator[dict[str, Any]]:
    for item in dataclasses.fields(instance):
        value = getattr(instance, item.name)
        usual = None if default is None else getattr(default, item.name, None)
        path = f"{key}.{item.name}"
        if dataclasses.is_dataclass(value):
            yield from _fields(path, value, usual)
        else:
            yield _entry(path, _data(value), default is None or value != usual, declaration(item))


def _entry(key: str, value: Any, is_set: bool, about: Declaration | None) -> dict[str, Any]:
    return {
        "key": key,
        "value": value,
        "set": is_set,
        "unit": about.unit if about else "",
        "minimum": about.low if about and math.isfinite(about.low) else None,
        "maximum": about.high if about and math.isfinite(about.high) else None,
        "doc": about.text if about else "",
    }


def _data(value: Any) -> Any:
    """Return dataclasses in a tuple, such as faults, as mappings."""
    if isinstance(value, tuple):
        return [dataclasses.asdict(item) if dataclasses.is_dataclass(item) else item for item in value]  # type: ignore[arg-type]
    return value


def _kind(scene: Scene) -> str:
    if scene.simulation is not None:
        return "simulated"
    if any(NODES[name].plays for name in scene.nodes):
        return "recording"
    return "hardware" if scene.touches_hardware else "mocks"


def _plain(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_plain(item) for item in value) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _unit(key: dict[str, Any]) -> str:
    return f" {key['unit']}" if key["unit"] else ""


def _range(key: dict[str, Any]) -> str:
    if key["minimum"] is None or key["maximum"] is None:
        return ""
    return f"{_plain(key['minimum'])} to {_plain(key['maximum'])}"
