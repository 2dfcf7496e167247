# SPDX-License-Identifier: Apache-2.0
"""Runs or continues the campaigns of the docking report, and writes page, figures and pictures."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_lab.campaigns import compare, runner
from deltacharger_lab.campaigns.docking import columns as docking_columns
from deltacharger_lab.campaigns.scene import load_campaign_scene
from deltacharger_lab.campaigns.store import CampaignSettings, Store, read_results, read_settings, scene_of, versions
from deltacharger_lab.reports.docking import arms, hostile, lean, plan as grounds, summary, targets
from deltacharger_lab.reports.docking.pictures import FORMS, PICTURES, without
from deltacharger_lab.reports.docking.plan import CampaignPart, DockingPlan
from deltacharger_lab.reports.report import Progress, Report

CAMPAIGNS = "campaigns"
_PAIRS = (
    ("random", "published"),
    ("exact", "random"),
    ("strike", "default"),
    *((f"{name}_exact", name) for name in ("assumed_stiffness", "rigid", "lean2", "lean5")),
)
_UNCHARGED_MOST = 60  # rows listed one by one

Record = Callable[[Sequence[dict[str, Any]]], None]


def run(
    plan: DockingPlan,
    directory: Path,
    workers: int,
    progress: Callable[[CampaignPart, int, int], Record],
    stop: Callable[[], bool],
    log: Progress,
) -> bool:
    """Run the missing dockings of the chosen campaigns, and return whether it was not stopped.

    Args:
        plan: campaigns and their dockings.
        directory: of the report; each campaign has a folder in `CAMPAIGNS`.
        workers: processes on this computer.
        progress: takes a campaign, its dockings and the number done; returns what to call with each batch of rows.
        stop: whether to end; running batches are finished and written.
        log: called with messages about workers.

    Raises:
        CampaignError: a folder has a campaign of other code, seed or scene, or workers died repeatedly.
    """
    (directory / CAMPAIGNS).mkdir(parents=True, exist_ok=True)
    for part in plan.parts:
        if part.name not in plan.chosen:
            continue
        folder = directory / CAMPAIGNS / part.name
        with Store(folder, _settings(part, plan.seed, folder)) as store:
            missing = store.missing()
            if missing:
                record = progress(part, store.settings.n, len(store.done))
                runner.run_missing(store, workers, record, stop, log)
        if stop():
            return False
    return True


def _settings(part: CampaignPart, seed: int, folder: Path) -> CampaignSettings:
    """Return the settings of a campaign, with the larger of the present and the previous number of dockings."""
    scene = load_campaign_scene(part.scene)
    count = part.count
    if (folder / "_campaign.json").exists():
        count = max(count, read_settings(folder).n)
    if scene.dockings:
        count = min(count, len(scene.dockings))
    return CampaignSettings(count, seed, part.exact, scene.content, scene.name, versions())


def build(plan: DockingPlan, directory: Path, command: str, progress: Progress) -> dict[str, Any]:
    """Write page, figures and pictures of all present campaigns, complete or not, and return the figures.

    Raises:
        CampaignError: a campaign cannot be read.
        OSError: a file cannot be written.
    """
    report = Report("docking", command, ("numpy", "pyarrow", "matplotlib"))
    rows = {part.name: each for part in plan.parts if (each := _read(directory / CAMPAIGNS / part.name)) is not None}
    folders = {name: directory / CAMPAIGNS / name for name in rows}
    settings = {name: read_settings(folder) for name, folder in folders.items()}
    faulty = {name: rows.pop(name) for name in hostile.SCENES if name in rows}
    ports = {name: rows.pop(name) for name in targets.SCENES if name in rows}
    progress("figures")
    every, near = summary.joined(rows, "random", "upright"), summary.joined(rows, "zero", "edge")
    upright = None if every is None else summary.part(every, every["degrees"] <= summary.UPRIGHT)
    forms = {"edge": "`edge`, ours", **{name: title for name, (title, _) in FORMS.items()}}
    results = report.results
    results |= {
        "quick": plan.quick,
        "seed": plan.seed,
        "simulated": True,
        "versions": {name: each.versions for name, each in settings.items()},
        "plan": [vars(part) | {"run": len(rows[part.name]["number"])} for part in plan.parts if part.name in rows],
        "not_run": [part.name for part in plan.parts if part.name not in folders],
        "parts": {name: summary.summarise(each) for name, each in rows.items()},
        "calibration": {name: summary.calibration(rows[name]) for name in summary.CALIBRATED if name in rows},
        "upright": summary.summarise(upright) if upright is not None else None,
        "uncharged": _uncharged(upright) if upright is not None else [],
        "drawn": summary.by_drawn(upright) if upright is not None else [],
        "nudges": summary.nudges(rows["nudged"]) if "nudged" in rows else {},
        "tilts": summary.by_tilt(rows["tilted"]) if "tilted" in rows else [],
        "arms": {name: arms.figures(rows[name]) for name in arms.SCENES if name in rows},
        "holding": {name: summary.holding(rows[name]) for name in ("yielding", "yielding_exact") if name in rows},
        "lean": {name: lean.figures(rows[name]) for name in lean.SCENES if name in rows},
        "lean_map": {name: lean.by_lean(rows[name]) for name in lean.MAP if name in rows},
        "hostile": {name: hostile.figures(each) for name, each in faulty.items()},
        "ports": {name: targets.figures(each) for name, each in ports.items()},
        "near_zero": summary.near_zero(near) if near is not None else {},
        "pairs": _pairs(folders),
    }
    results["targets"] = [
        *summary.targets(results["parts"], results["upright"]),
        *arms.targets(results["arms"]),
        *lean.targets(results["lean"]),
        *hostile.targets(results["hostile"]),
        *targets.targets(results["ports"]),
    ]
    progress("pictures")
    report.draw(PICTURES, directory, without(rows), rows=rows)
    exact = {part.name: part.exact for part in plan.parts}
    shown = {name: forms[name] for name in forms if name in rows}
    return report.write(directory, view=summary, grounds=grounds, leans=lean, exact=exact, forms=shown)


def _read(folder: Path) -> summary.Columns | None:
    """Return the rows of a campaign; None for none."""
    if not any(folder.glob("part-*.parquet")):
        return None
    known = docking_columns(scene_of(read_settings(folder).to_json())[1])
    return summary.columns(read_results(folder, [name for name in known if name != "error"]))


def _uncharged(upright: summary.Columns) -> list[dict[str, Any]]:
    """Return the dockings that did not charge, each with the data to run it again."""
    keys = ("campaign", "number", "degrees", "code_name", "message")
    refused = np.flatnonzero(~upright["charged"].astype(bool))[:_UNCHARGED_MOST]
    columns = [upright[key][refused].tolist() for key in keys]
    return [dict(zip(keys, each, strict=True)) for each in zip(*columns, strict=True)]


def _pairs(folders: dict[str, Path]) -> list[dict[str, Any]]:
    """Return the comparisons of campaigns on the same dockings."""
    return [
        {"names": [a, b], **compare.compare_campaigns(folders[a], folders[b])}
        for a, b in _PAIRS
        if {a, b} <= folders.keys()
    ]
