# SPDX-License-Identifier: Apache-2.0
"""The folder of a campaign's results: its settings, and a Parquet file per batch, written completely or not at all."""

from __future__ import annotations

import ast
import fcntl
import functools
import hashlib
import importlib
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO, Any, BinaryIO

import pyarrow
from pyarrow import compute, parquet

from deltacharger_core import environment, files
from deltacharger_lab.campaigns.docking import columns
from deltacharger_lab.campaigns.scene import CampaignScene, parse_campaign_scene

_COMPUTES = ("core", "kinematics", "driver", "sim", "docking", "tactile", "lab.campaigns", "lab.second", "lab.training")
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
        read = CampaignSettings(**files.parse_json(text))
        kinds = {"seed": int, "exact": bool, "scene": dict, "scene_name": str, "versions": dict}
        for name, kind in ({"n": int} | kinds).items():
            if type(value := getattr(read, name)) is not kind:
                raise ValueError(f"{name} is {files.brief(value)}")
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
        "deltacharger": environment.package_version(),
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
            shell = path.stem.endswith("_node") or path.parent.name == "ros"
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


SETTINGS = "_campaign.json"
"""Readers of Parquet folders skip names that begin with _."""
_LARGEST_PART, _MOST_TEXT = 64 * 2**20, 64 * 2**20  # bytes
_MOST_VALUES = 1_000_000  # of a file; a batch of 50 rows has 5000
_LIMITS = {"thrift_string_size_limit": 2**20, "thrift_container_size_limit": 10_000}
_LONGEST_PROBLEM = 300  # characters
_LOCK = "_lock"


class Store:
    """Results of a running campaign; a context that reserves the folder for this process.

    Args:
        folder: created if missing.
        settings: of the campaign.

    Raises:
        CampaignError: another process writes there, or the folder has other files or a campaign
            with other settings; the message names the differences.
    """

    def __init__(self, folder: Path, settings: CampaignSettings) -> None:
        self.folder = folder
        self.settings = settings
        self.done: set[int] = set()
        self._schema = _schema(settings)
        self._lock: IO[str] | None = None

    def __enter__(self) -> Store:
        if self.folder.exists() and not self.folder.is_dir():
            raise CampaignRefused(f"{self.folder} is a file; give a folder, which is created if missing")
        strangers = self.folder.is_dir() and any(self.folder.iterdir()) and not (self.folder / _LOCK).exists()
        if strangers and not (self.folder / SETTINGS).exists():
            raise CampaignRefused(f"{self.folder} has other files and no campaign; give another folder")
        self.folder.mkdir(parents=True, exist_ok=True)
        self._lock = self._hold()
        try:
            self._open()
        except BaseException:
            self._lock.close()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        if self._lock is not None:
            self._lock.close()  # releases the lock

    def missing(self) -> list[int]:
        """Return the numbers that have no row yet."""
        return [number for number in range(self.settings.n) if number not in self.done]

    def add(self, rows: Sequence[Mapping[str, Any]]) -> int:
        """Write new rows as one file and return their number; rows already there are left out."""
        fresh = {row["number"]: row for row in rows if row["number"] not in self.done}
        if not fresh:
            return 0
        table = pyarrow.Table.from_pylist([fresh[number] for number in sorted(fresh)], schema=self._schema)
        with files.atomic_write(self.folder / f"part-{min(fresh):09d}.parquet") as path:
            parquet.write_table(table, path)
        self.done.update(fresh)
        return len(fresh)

    def _hold(self) -> IO[str]:
        lock = (self.folder / _LOCK).open("w", encoding="utf-8")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            lock.close()
            raise CampaignError(
                f"another process is writing to {self.folder}; wait for it or give another --out"
            ) from error
        return lock

    def _open(self) -> None:
        files.remove_unfinished(self.folder)
        if (self.folder / SETTINGS).exists():
            differences = read_settings(self.folder).differences(self.settings)
            if differences:
                named = "; ".join(f"{what} is {shall}, was {was}" for what, was, shall in differences)
                raise CampaignRefused(
                    f"{self.folder} has a campaign with other settings: {named}. Give the same ones to continue, or "
                    "another --out"
                )
            self.done = {number for part in read_parts(self.folder, ["number"]) for number in part["number"]}
        files.write_text(self.folder / SETTINGS, self.settings.to_json())


def read_settings(folder: Path) -> CampaignSettings:
    """Return the settings of a campaign.

    Raises:
        CampaignError: the folder has none, or a damaged one.
    """
    path = folder / SETTINGS
    try:
        settings = CampaignSettings.from_json(files.read_text(path))
        scene_of(settings.to_json())  # checks the scene, which every reader needs
        return settings
    except FileNotFoundError as error:
        raise CampaignRefused(f"{folder} has no campaign: {SETTINGS} is missing") from error
    except (ValueError, TypeError, KeyError, OSError) as error:
        raise CampaignError(f"{path} cannot be read as the settings of a campaign: {error}") from error


def read_results(folder: Path, wanted: Sequence[str] = ()) -> dict[str, list[Any]]:
    """Return the results of a campaign, complete or not: each column's values in the order of the dockings.

    Args:
        folder: of the campaign.
        wanted: columns including `number`; empty = all.

    Raises:
        CampaignError: the folder has no campaign, a damaged file or a docking twice.
    """
    names = list(wanted or columns(scene_of(read_settings(folder).to_json())[1]))
    result: dict[str, list[Any]] = {name: [] for name in names}
    for part in read_parts(folder, names):
        for name in names:
            result[name] += part[name]
    numbers = result["number"]
    if len(set(numbers)) != len(numbers):
        raise CampaignError(f"{folder} has a docking twice; remove files that were copied into it")
    order = sorted(range(len(numbers)), key=numbers.__getitem__)
    return {name: [values[index] for index in order] for name, values in result.items()}


def read_parts(folder: Path, names: Sequence[str]) -> Iterator[dict[str, list[Any]]]:
    """Yield the named columns of each file of a campaign.

    Raises:
        CampaignError: a file is damaged.
        CampaignRefused: a file lacks a column, because an earlier version wrote it.
    """
    for path in sorted(folder.glob("part-*.parquet")):
        try:
            with files.open_file(path, _LARGEST_PART) as stream:
                yield _read_part(stream, list(names))
        except CampaignRefused as error:
            raise CampaignRefused(f"{path} {error}") from error
        except Exception as error:  # pyarrow raises many kinds for damaged files
            problem = f"{error}"[:_LONGEST_PROBLEM]
            raise CampaignError(
                f"{path} cannot be read: {problem}; remove it; the same command runs its dockings again"
            ) from error


def _read_part(stream: BinaryIO, names: list[str]) -> dict[str, list[Any]]:
    """Return the named columns of a file, after its metadata are checked against the limits of such a file.

    Texts are read dictionary-encoded, so that a million repetitions take no memory.
    """
    file = parquet.ParquetFile(stream, **_LIMITS)
    meta, kinds = file.metadata, file.schema_arrow
    if missing := [name for name in names if name not in kinds.names]:
        raise CampaignRefused(
            f"has no column {', '.join(missing)}; an earlier version wrote it. Run the campaign with another --out"
        )
    texts = [name for name in names if kinds.field(name).type == pyarrow.string()]
    numbers = (pyarrow.int64(), pyarrow.float64(), pyarrow.bool_(), pyarrow.string())
    if any(kinds.field(name).type not in numbers for name in names) or meta.num_rows * meta.num_columns > _MOST_VALUES:
        raise ValueError("it has too many rows, or other content than rows of a campaign")
    # Not the columns' metadata: damaged ones crash the process (pyarrow 26), but reading refuses them.
    if sum(meta.row_group(group).total_byte_size for group in range(meta.num_row_groups)) > _MOST_TEXT:
        raise ValueError("it unpacks to more than results can take")
    stream.seek(0)
    table = parquet.ParquetFile(stream, read_dictionary=texts, **_LIMITS).read(columns=names).select(names)
    if sum(_text_length(chunk) for name in texts for chunk in table[name].chunks) > _MOST_TEXT:
        raise ValueError("its texts are too long")
    found: dict[str, list[Any]] = table.to_pydict()
    if not all(isinstance(number, int) and number >= 0 for number in found.get("number", ())):
        raise ValueError("a docking in it has no number")
    return found


def _text_length(chunk: Any) -> int:
    """Return the bytes of a column's texts without encoding."""
    return int(compute.sum(compute.binary_length(chunk.dictionary).take(chunk.indices)).as_py() or 0)


def _schema(settings: CampaignSettings) -> Any:
    kinds = {int: pyarrow.int64(), float: pyarrow.float64(), bool: pyarrow.bool_(), str: pyarrow.string()}
    scene = scene_of(settings.to_json())[1]
    return pyarrow.schema(
        [pyarrow.field(name, kinds[kind], metadata={"doc": about}) for name, (kind, about) in columns(scene).items()]
    )
