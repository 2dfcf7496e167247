# SPDX-License-Identifier: Apache-2.0
"""Scenes of campaigns: a YAML file with what to draw for each docking, at random or from a list."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from deltacharger_bringup.scenes.scene import find_file, read_file
from deltacharger_core import files, parameters, yaml_file
from deltacharger_lab.campaigns.keys import DERIVED, TAKEN, known_keys, refuse_contradictions
from deltacharger_lab.campaigns.parts import Spread, Value, assumed_geometry, build_parts, read_spread

DEFAULT = "default"
_PACKAGED = Path(__file__).parents[1] / "scenes"
SECTIONS = (
    *("target", "shift", "electrode", "camera", "hand_eye", "gravity", "estimator", "assumed", "taxels", "pads"),
    *("published", "hostile", "targets", "profile", "parked", "nudge", "world", "second", "docking"),
)
_BASE = "based_on"
_TOP = ("name", "description", _BASE, "dockings", *SECTIONS)
_LONGEST = 100_000  # dockings of a list
_SHAPES = {"choose", "mean", "stddev", "log", "either_sign"}  # of a mapping that describes one value


@dataclass(frozen=True)
class CampaignScene:
    """Distributions and lists that define each docking of a campaign.

    Attributes:
        name: of the scene.
        description: one or two sentences for people.
        spreads: distribution of each key; other keys keep their default.
        dockings: values of the first, second, … docking, which take precedence over the spreads; empty = none.
        content: of the file, for the record.
        file: its path.
        bases: scenes to choose from for each docking, instead of `spreads`; empty = none.
    """

    name: str
    description: str = ""
    spreads: Mapping[str, Spread] = field(default_factory=dict)
    dockings: tuple[Mapping[str, Value], ...] = ()
    content: Mapping[str, Any] = field(default_factory=dict)
    file: str = ""
    bases: tuple[CampaignScene, ...] = ()

    @property
    def hostile(self) -> bool:
        """Whether its dockings are judged under faults."""
        return "hostile" in self.spreads

    @property
    def targets(self) -> bool:
        """Whether its dockings charge kinds of targets to their end."""
        return "targets" in self.spreads

    def drawn(self) -> list[str]:
        """Return the keys that the scene sets, in the order of the results' columns."""
        given = set(self.spreads).union(*self.dockings, *(base.drawn() for base in self.bases))
        return sorted(given.union(*(DERIVED.get(name, ()) for name in given)))


def load_campaign_scene(name_or_file: str) -> CampaignScene:
    """Read and check a scene: a packaged one by its name, or a YAML file.

    Raises:
        SceneError: there is none, it is not YAML, or a key or value in it is refused.
    """
    return read_file(find_file(name_or_file, packaged_campaigns(), "campaign"), parse_campaign_scene)


def packaged_campaigns() -> dict[str, Path]:
    """Return the file of every packaged scene of campaigns by name."""
    return {path.stem: path for path in sorted(_PACKAGED.glob("*.yaml"))}


def _with_base(content: Any, name: str, above: tuple[str, ...] = ()) -> Any:
    """Return a scene's content merged into its packaged base scene, whose keys it may override.

    Of several base scenes to choose from, each takes its place in the content.
    """
    if not isinstance(content, Mapping) or _BASE not in content:
        return content
    base = content[_BASE]
    if isinstance(base, Mapping) and set(base) == {"choose"} and isinstance(base["choose"], list) and base["choose"]:
        several = [
            each if isinstance(each, Mapping) else {"name": each, **_with_base({_BASE: each}, name, above)}
            for each in base["choose"]
        ]
        return {**content, _BASE: {"choose": several}}
    packaged = packaged_campaigns()
    if not isinstance(base, str) or base not in packaged or base in (*above, name):
        raise parameters.ParameterError(
            _BASE, base, f"no other packaged campaign{parameters.did_you_mean(base, packaged)}: {', '.join(packaged)}"
        )
    rest = {key: value for key, value in content.items() if key != _BASE}
    under = {
        key: each
        for key, each in _with_base(yaml_file.read_yaml(packaged[base]), base, (*above, name)).items()
        if key != "name"
    }
    return _laid_over(under, rest)


def _laid_over(under: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Merge two nested mappings; where both have a value, `over` wins; null in it removes the key."""
    merged = dict(under)
    for key, value in over.items():
        below = merged.get(key)
        spread = isinstance(value, Mapping) and set(value) <= _SHAPES
        both = isinstance(value, Mapping) and isinstance(below, Mapping) and not spread
        merged[key] = _laid_over(below, value) if both and below is not None else value
        if value is None:
            del merged[key]
    return merged


def parse_campaign_scene(content: Any, name: str, file: str = "") -> CampaignScene:
    """Build a scene from the content of a YAML file.

    Args:
        content: the mapping.
        name: used if the mapping has no `name`.
        file: for messages.

    Raises:
        ParameterError: a key or value is refused, or two contradict each other.
    """
    content = {} if content is None else _with_base(content, name)
    if not isinstance(content, Mapping):
        raise parameters.ParameterError("(top)", content, "is not a mapping of keys to values")
    for key in content:
        if key not in _TOP:
            known = parameters.did_you_mean(key, _TOP) or f"; known are {', '.join(_TOP)}"
            raise parameters.ParameterError(str(key), content[key], f"unknown key{known}")
    for key in ("name", "description"):
        if not isinstance(content.get(key, ""), str):
            raise parameters.ParameterError(key, content[key], f"{files.brief(content[key])} is not text")
    spreads = dict(_spreads(content))
    own = {key: value for key, value in content.items() if key in SECTIONS}
    several = content.get(_BASE, {}).get("choose", ())
    scene = CampaignScene(
        name=content.get("name", name),
        description=" ".join(content.get("description", "").split()),
        spreads=spreads,
        dockings=_read_dockings(content.get("dockings"), spreads),
        content=content,
        file=file,
        bases=tuple(
            parse_campaign_scene(_laid_over(each, own), f"{name} {index}") for index, each in enumerate(several)
        ),
    )
    _check_contradictions(scene)
    return scene


def _spreads(content: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Spread]]:
    for section in SECTIONS:
        if section in content:
            where = f"{path}.{section}" if path else section
            for name, key, value in _leaves(content[section], section, where):
                yield name, read_spread(value, key, f"{path}.{name}" if path else name)


def _leaves(value: Any, name: str, where: str) -> Iterator[tuple[str, parameters.Declaration, Any]]:
    """Yield every key below a section with its value; `where` is its place in the file."""
    keys = known_keys()
    if name in keys:
        yield name, keys[name], value
        return
    if name in TAKEN:
        raise parameters.ParameterError(where, value, f"is not set here; {TAKEN[name]}")
    below = sorted({key[len(name) + 1 :].split(".")[0] for key in (*keys, *TAKEN) if key.startswith(f"{name}.")})
    if not below:
        parent, _, last = name.rpartition(".")
        beside = sorted({key[len(parent) + 1 :].split(".")[0] for key in keys if key.startswith(f"{parent}.")})
        raise parameters.ParameterError(
            where, value, f"unknown key{parameters.did_you_mean(last, beside)}; known: {', '.join(beside)}"
        )
    if not isinstance(value, Mapping):
        raise parameters.ParameterError(
            where, value, f"{files.brief(value)} is not a mapping; known keys: {', '.join(below)}"
        )
    for key, item in value.items():
        yield from _leaves(item, f"{name}.{key}", f"{where}.{key}")


def _read_dockings(entries: Any, spreads: Mapping[str, Spread]) -> tuple[Mapping[str, Value], ...]:
    if entries is None:
        return ()
    if not isinstance(entries, list) or not 0 < len(entries) <= _LONGEST:
        raise parameters.ParameterError(
            "dockings", entries, f"is not a list of 1 to {_LONGEST} dockings, each a mapping"
        )
    result = []
    for index, entry in enumerate(entries):
        where = f"dockings[{index}]"
        if not isinstance(entry, Mapping):
            raise parameters.ParameterError(where, entry, f"{files.brief(entry)} is not a mapping of keys to values")
        for key in entry:
            if key not in SECTIONS:
                raise parameters.ParameterError(
                    f"{where}.{key}", entry[key], f"unknown key{parameters.did_you_mean(key, SECTIONS)}"
                )
        values: dict[str, Value] = {}
        for name, spread in _spreads(entry, where):
            if spread.shape != "fixed":
                raise parameters.ParameterError(
                    f"{where}.{name}", name, "a listed docking has fixed values; give ranges outside the list"
                )
            if name in spreads:
                raise parameters.ParameterError(f"{where}.{name}", name, "is set here and for all dockings; keep one")
            values[name] = spread.numbers[0]
        result.append(values)
    return tuple(result)


def _check_contradictions(scene: CampaignScene) -> None:
    """Refuse keys without effect or in contradiction."""
    if "gravity.anywhere" not in scene.drawn():
        _without_effect(scene, "gravity.tilt", ("gravity.azimuth", "gravity.known"), unset=True)
    for name, made in DERIVED.items():
        for other in made if name in scene.drawn() else ():
            if other in scene.spreads or any(other in values for values in scene.dockings):
                raise parameters.ParameterError(other, other, f"is drawn by {name}; remove one of them")
    refuse_contradictions(scene.spreads, scene.dockings)
    listed: list[Mapping[str, Value]] = [{}, *scene.dockings]
    for values in listed:
        for end in (0, 1):
            corner = {name: spread.ends[end] for name, spread in scene.spreads.items()}
            assumed_geometry({**corner, **values})
            build_parts({**corner, **values})


def _without_effect(scene: CampaignScene, cause: str, dependent: tuple[str, ...], unset: bool = False) -> None:
    spread = scene.spreads.get(cause)
    if any(cause in values for values in scene.dockings):
        return
    zero = spread.ends == (0.0, 0.0) and spread.shape != "normal" if spread is not None else unset
    for name in dependent:
        if zero and name in scene.spreads:
            raise parameters.ParameterError(
                name, scene.spreads[name].ends[0], f"has no effect if {cause} is 0; remove one"
            )
