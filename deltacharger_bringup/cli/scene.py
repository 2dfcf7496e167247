# SPDX-License-Identifier: Apache-2.0
"""`deltacharger scene`: list, check and explain scenes."""

import argparse
import dataclasses
import math
from collections.abc import Iterator
from typing import Any

from deltacharger_bringup.cli.output import DONE, WRONG_INPUT, Result, wrong_input
from deltacharger_bringup.scenes.node_table import NODES
from deltacharger_bringup.scenes.scene import Scene, SceneError, load_scene, packaged_scenes, problems, servos_apart
from deltacharger_core.parameters import Declaration, declaration


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Add the options of `scene`."""
    add = parser.add_argument
    text = "check these; of a single one, also show what it sets (default: list every packaged scene)"
    add("scenes", nargs="*", metavar="NAME|FILE", help=text)
    add("--all", action="store_true", help="of a single scene, also show the keys with default values")


def load_for_command(name_or_file: str) -> Scene:
    """Return the scene; CommandError with exit code 2 if it is refused."""
    with wrong_input(SceneError):
        return load_scene(name_or_file)


def scene(options: argparse.Namespace) -> Result:
    """Check scenes: the first problem of each, and nodes with different files of measured servos."""
    reports, lines, remarks = [], [], []
    names = options.scenes or list(packaged_scenes())
    for name in names:
        report: dict[str, Any] = {"scene": name, "kind": "refused", "description": "", "file": name, "ok": False}
        report |= {"key": "", "problem": "", "warnings": []}
        try:
            loaded = load_scene(name)
            report |= {"scene": loaded.name, "description": loaded.description, "file": loaded.file}
            wrong = next(problems(loaded), None)
            if wrong is not None:
                raise SceneError(loaded.file, *wrong)
            warnings = [f"{key}: {text}" for key, text in servos_apart(loaded.nodes, loaded.parameters)]
            remarks += [f"{loaded.file}: warning: {warning}" for warning in warnings]
            kind = "hardware" if loaded.touches_hardware else "mocks" if loaded.simulation is None else "simulated"
            report |= {"kind": kind, "ok": True, "warnings": warnings}
            if len(names) == 1:
                lines += ["", *_explained(loaded, report, options.all)]
        except SceneError as error:
            report |= {"file": error.file, "key": error.key, "problem": error.problem}
            remarks.append(str(error))
        reports.append(report)
    width = max(len(report["scene"]) for report in reports)
    table = [f"{report['scene']:<{width}}  {report['kind']:<9}  {report['description']}".rstrip() for report in reports]
    code = DONE if all(report["ok"] for report in reports) else WRONG_INPUT
    refused = "; ".join(f"{report['file']}: {report['problem']}" for report in reports if not report["ok"])
    details = {"scenes": reports} | ({"error": refused} if refused else {})
    return Result("\n".join([*table, *lines]), details, code, remarks)


def _explained(scene: Scene, report: dict[str, Any], everything: bool) -> Iterator[str]:
    """Yield what a scene sets and cannot do, and add it to a report; `everything`: all its keys."""
    keys = list(describe(scene))
    lacks = {name: spec.lacks for name, spec in NODES.items() if spec.lacks and not _has(scene, name)}
    report |= {"keys": keys, "lacks": lacks}
    for key in keys:
        if key["set"] or everything:
            yield f"{key['key']} = {_plain(key['value'])} {key['unit']}".rstrip()
            yield from [f"    {key['doc']}{'' if key['set'] else ' (default)'}"] if key["doc"] else []
    if not everything:
        yield f"\n{sum(not key['set'] for key in keys)} more keys have their default; --all shows them."
    yield from (f"without {name}: {lack}" for name, lack in lacks.items())


def _has(scene: Scene, name: str) -> bool:
    """Return whether a scene starts a node or one that replaces it."""
    return any(each == name or NODES[each].stands_in_for == name for each in scene.nodes)


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


def _plain(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_plain(item) for item in value) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)
