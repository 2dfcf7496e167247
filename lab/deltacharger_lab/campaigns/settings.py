# SPDX-License-Identifier: Apache-2.0
"""Record of everything that decides a campaign's results: compared before it continues, sent to every worker."""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib
import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from deltacharger_core import environment
from deltacharger_core.bounded_file import brief, parse_json
from deltacharger_core.version import package_version
from deltacharger_lab.campaigns.scene import CampaignScene, parse_campaign_scene

_COMPUTES = ("core", "kinematics", "driver", "sim", "docking", "tactile", "lab.campaigns", "lab.second")
"""Packages, deltacharger_…, with the code and models that decide a docking."""


class CampaignError(RuntimeError):
    """A campaign cannot be run, continued or read. The message states why and what to do."""


class CampaignRefused(CampaignError):
    """The input does not fit: settings that differ from the folder's, no campaign there, no pairs."""


@dataclass(frozen=True)
class CampaignSettings:
    """Everything that decides the rows of a campaign, and their wanted number.

    Attributes:
        n: dockings.
        seed: of the campaign.
        exact: whether every tick and frame is computed, as in the nodes.
        scene: content of the scene.
        scene_name: name of the scene.
        versions: of Python, numpy and code.
    """

    n: int
    seed: int
    exact: bool
    scene: Mapping[str, Any]
    scene_name: str
    versions: Mapping[str, str] = field(default_factory=dict)

    def to_json(self) -> str:
        """Return the record as text, equal for equal settings."""
        return json.dumps(asdict(self), sort_keys=True, ensure_ascii=False)

    @staticmethod
    def from_json(text: str) -> CampaignSettings:
        """Read the output of `to_json`.

        Raises:
            ValueError, TypeError, KeyError: it is not such a record.
        """
        read = CampaignSettings(**parse_json(text))
        kinds = {"seed": int, "exact": bool, "scene": dict, "scene_name": str, "versions": dict}
        for name, kind in ({"n": int} | kinds).items():
            if type(value := getattr(read, name)) is not kind:
                raise ValueError(f"{name} is {brief(value)}")
        if read.n < 0:
            raise ValueError(f"n is {read.n}")
        return read

    def differences(self, other: CampaignSettings) -> list[tuple[str, str, str]]:
        """Return the differences to `other`, each as (what, value here, value there); a larger n may differ."""
        pairs: dict[str, tuple[Any, Any]] = {
            name: (getattr(self, name), getattr(other, name)) for name in ("seed", "exact")
        }
        if other.n < self.n:
            pairs["n"] = self.n, other.n
        pairs["scene"] = self.scene_name, other.scene_name
        was, shall = flat(self.scene), flat(other.scene)
        for key in sorted((was.keys() | shall.keys()) - {"name", "description"}):
            pairs[f"scene's {key}"] = was.get(key, "not given"), shall.get(key, "not given")
        for key in sorted(self.versions.keys() | other.versions.keys()):
            pairs[f"version of {key}"] = self.versions.get(key), other.versions.get(key)
        return [(what, _shown(one), _shown(two)) for what, (one, two) in pairs.items() if one != two]


@functools.lru_cache(maxsize=8)
def scene_of(text: str) -> tuple[CampaignSettings, CampaignScene]:
    """Return settings and scene of a record; read once per process."""
    settings = CampaignSettings.from_json(text)
    return settings, parse_campaign_scene(settings.scene, settings.scene_name)


@functools.cache
def versions() -> dict[str, str]:
    """Return what must be equal on two machines for equal rows: Python, numpy, and the code that computes."""
    import numpy as np

    return {
        "python": f"{sys.version_info[0]}.{sys.version_info[1]}",
        "numpy": np.__version__,
        "deltacharger": package_version(),
        "code": _digest(),
    }


def _digest() -> str:
    """Return 16 hexadecimal digits that change with the code and models that decide a docking."""
    digest = hashlib.sha256()
    for name, path in computing():
        digest.update(name.encode() + meaning(path))
    return digest.hexdigest()[:16]


def computing() -> Iterator[tuple[str, Path]]:
    """Yield name and path of every file that may decide a docking: code without its ROS shells, and models."""
    for package in _COMPUTES:
        root = Path(str(importlib.import_module(f"deltacharger_{package}").__file__)).parent
        for path in sorted(root.rglob("*")):
            shell = path.stem.endswith(("_node", "_node_io")) or path.parent.name == "ros"
            if path.suffix in (".py", ".npz", ".json") and not shell:
                yield f"{package}/{path.relative_to(root).as_posix()}", path
    yield "config/target_kinds.yaml", environment.config("target_kinds.yaml")[0]


def meaning(path: Path) -> bytes:
    """Return code without comments, docstrings and layout, which change no docking; of other files, every byte."""
    content = path.read_bytes()
    if path.suffix != ".py":
        return content
    tree = ast.parse(content)
    for node in ast.walk(tree):
        if isinstance(body := getattr(node, "body", None), list):
            body[:] = [
                line for line in body if not (isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant))
            ]
    return ast.dump(tree).encode()


def flat(content: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Return a nested mapping with dotted keys."""
    found: dict[str, Any] = {}
    for key, value in content.items():
        name = f"{path}.{key}" if path else str(key)
        found |= flat(value, name) if isinstance(value, Mapping) else {name: value}
    return found


def _shown(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
