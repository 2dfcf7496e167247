# SPDX-License-Identifier: Apache-2.0
"""Runs the campaigns of the docking report, or goes on with them, and writes page, figures and pictures."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_lab.campaigns import paper
from deltacharger_lab.campaigns.compare import compare_campaigns
from deltacharger_lab.campaigns.docking import columns as docking_columns
from deltacharger_lab.campaigns.runner import run_missing
from deltacharger_lab.campaigns.scene import load_campaign_scene
from deltacharger_lab.campaigns.settings import CampaignSettings, scene_of, versions_of
from deltacharger_lab.campaigns.store import Store, read_results, read_settings
from deltacharger_lab.reports.docking import page, summary
from deltacharger_lab.reports.docking.pictures import jobs, without
from deltacharger_lab.reports.docking.plan import CampaignPart, DockingPlan
from deltacharger_lab.reports.report import Report

CAMPAIGNS = "campaigns"
_PAIRS = (("random", "paper"), ("random", "classes"), ("random", "published"), ("exact", "random"))
_UNCHARGED_MOST = 60  # rows told one by one

Told = Callable[[Sequence[dict[str, Any]]], None]


def run(
    plan: DockingPlan,
    directory: Path,
    workers: int,
    progress: Callable[[CampaignPart, int, int], Told],
    stop: Callable[[], bool],
    tell: Callable[[str], None],
) -> bool:
    """Run what is missing of the chosen campaigns, and return whether they are complete but for what cannot be run.

    Args:
        plan: which, and how many dockings of each.
        directory: of the report; each campaign has a folder in `CAMPAIGNS`.
        workers: processes on this computer.
        progress: given a campaign, its dockings and how many there are, returns what is told of each batch of rows.
        stop: whether to end; what runs is finished and written.
        tell: told what happened to workers.

    Raises:
        CampaignError: a folder holds a campaign of other code, seed or scene, or workers died again and again.
    """
    (directory / CAMPAIGNS).mkdir(parents=True, exist_ok=True)
    for part in plan.parts:
        if part.name not in plan.chosen:
            continue
        folder = directory / CAMPAIGNS / part.name
        if paper.are_wanted(load_campaign_scene(part.scene).content):
            try:
                paper.prepare(folder, tell)
            except ModuleNotFoundError as error:
                tell(f"{part.name} is left out: {error.name} is not installed; install deltacharger[train]")
                continue
        with Store(folder, _settings(part, plan.seed, folder)) as store:
            missing = store.missing()
            if missing:
                told = progress(part, store.settings.n, len(store.done))
                run_missing(store, workers, "", 0, told, stop, tell)
        if stop():
            return False
    return True


def _settings(part: CampaignPart, seed: int, folder: Path) -> CampaignSettings:
    """Return the settings of a campaign, with as many dockings as are wanted or were wanted before."""
    scene = load_campaign_scene(part.scene)
    count = part.count
    if (folder / "_campaign.json").exists():
        count = max(count, read_settings(folder).n)
    if scene.dockings:
        count = min(count, len(scene.dockings))
    return CampaignSettings(
        count, seed, part.approach, part.exact, scene.content, scene.name, versions_of(scene.content)
    )


def build(plan: DockingPlan, directory: Path, command: str, progress: Callable[[str], None]) -> dict[str, Any]:
    """Write page, figures and pictures of all campaigns that are there, complete or not, and return the figures.

    Raises:
        CampaignError: a campaign cannot be read.
        OSError: a file cannot be written.
    """
    report = Report("docking", command, ("numpy", "pyarrow", "matplotlib"))
    rows = {part.name: each for part in plan.parts if (each := _read(directory / CAMPAIGNS / part.name)) is not None}
    folders = {name: directory / CAMPAIGNS / name for name in rows}
    settings = {name: read_settings(folder) for name, folder in folders.items()}
    progress("figures")
    upright = _upright(rows)
    results = report.results
    results |= {
        "quick": plan.quick,
        "seed": plan.seed,
        "simulated": True,
        "versions": {name: each.versions for name, each in settings.items()},
        "plan": [vars(part) | {"run": len(rows[part.name]["number"])} for part in plan.parts if part.name in rows],
        "not_run": [part.name for part in plan.parts if part.name not in rows],
        "parts": {name: summary.summarise(each) for name, each in rows.items()},
        "calibration": {
            name: summary.calibration(rows[name]) for name in ("random", "edge", "soft", "tilted") if name in rows
        },
        "upright": summary.summarise(upright) if upright is not None else None,
        "uncharged": _uncharged(rows),
        "drawn": summary.by_drawn(upright) if upright is not None else [],
        "tilts": summary.by_tilt(rows["tilted"]) if "tilted" in rows else [],
        "near_zero": _near_zero(rows),
        "pairs": _pairs(folders),
    }
    results["targets"] = summary.targets(results["parts"], results["upright"])
    progress("pictures")
    report.draw(jobs(results, rows), directory, without(rows))
    return report.write(directory, view=page)


def _read(folder: Path) -> summary.Columns | None:
    """Return the rows of a campaign; None where it has none."""
    if not any(folder.glob("part-*.parquet")):
        return None
    known = docking_columns(scene_of(read_settings(folder).to_json())[1])
    return summary.columns(read_results(folder, [name for name in known if name != "error"]))


def _upright(rows: dict[str, summary.Columns]) -> summary.Columns | None:
    """Return the dockings with magnets, by our own form, that are to be charged."""
    parts = [rows[name] for name in ("random", "upright") if name in rows]
    if not parts:
        return None
    every = summary.joined(parts, tuple(name for name in parts[0] if all(name in part for part in parts)))
    inside = every["degrees"] <= summary.UPRIGHT
    return {name: values[inside] for name, values in every.items()}


def _uncharged(rows: dict[str, summary.Columns]) -> list[dict[str, Any]]:
    """Return the upright dockings that did not charge, each with what it takes to run it again."""
    found = []
    for name in ("random", "upright"):
        for index in (
            np.flatnonzero(~rows[name]["charged"] & (rows[name]["degrees"] <= summary.UPRIGHT)) if name in rows else ()
        ):
            each = {key: rows[name][key][index] for key in ("number", "degrees", "code_name", "message")}
            found.append({"campaign": name, **{key: _plain(value) for key, value in each.items()}})
    return found[:_UNCHARGED_MOST]


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _near_zero(rows: dict[str, summary.Columns]) -> dict[str, Any]:
    """Return how dockings ended whose true clearance at the decisive estimate was small, by bins of it (mm)."""
    parts = [rows[name] for name in ("zero", "edge") if name in rows]
    if not parts:
        return {}
    every = summary.joined(parts, ("last_clearance", "charged", "energised_unsafe"))
    clear = 1000.0 * every["last_clearance"].astype(float)
    edges = (-math.inf, -1.0, -0.5, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, math.inf)
    bins = []
    for low, high in itertools.pairwise(edges):
        inside = (clear >= low) & (clear < high)
        bins.append({"low": low, "high": high, **summary.rate(int(every["charged"][inside].sum()), int(inside.sum()))})
    return {"bins": bins, "unknown": int(np.sum(~np.isfinite(clear)))}


def _pairs(folders: dict[str, Path]) -> list[dict[str, Any]]:
    """Return the comparisons of campaigns on the same dockings."""
    return [
        {"names": [a, b], **compare_campaigns(folders[a], folders[b])} for a, b in _PAIRS if {a, b} <= folders.keys()
    ]
