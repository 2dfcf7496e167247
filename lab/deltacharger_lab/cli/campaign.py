# SPDX-License-Identifier: Apache-2.0
"""`deltacharger campaign`: many simulated dockings, and the comparison of two campaigns."""

import argparse
import contextlib
import signal
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from deltacharger_bringup.cli import arguments, output
from deltacharger_bringup.scenes.scene import SceneError
from deltacharger_lab.campaigns import compare, runner
from deltacharger_lab.campaigns.scene import load_campaign_scene
from deltacharger_lab.campaigns.store import (
    CampaignError,
    CampaignRefused,
    CampaignSettings,
    Store,
    read_results,
    scene_of,
    versions,
)
from deltacharger_lab.campaigns.summary import COLUMNS, summarise

_DEFAULT_COUNT = 100


_DEFAULT_SCENES = "default"


def add_campaign(parser: argparse.ArgumentParser) -> None:
    """Add the options of `campaign`."""
    number = "dockings (default: 100, or all that the campaign lists)"
    parser.add_argument("-n", type=arguments.integer(1, 10_000_000), metavar="N", help=number)
    parser.add_argument("--seed", type=arguments.SEED, default=1, metavar="S", help="random seed (1)")
    scenes = f"packaged campaign or YAML file with the distributions (default: {_DEFAULT_SCENES})"
    parser.add_argument("--scenes", default=_DEFAULT_SCENES, metavar="NAME|FILE", help=scenes)
    parser.add_argument("--exact", action="store_true", help="compute every tick and frame, as the nodes do; slower")
    parser.add_argument(
        "--workers", type=arguments.integer(1, 1024), metavar="K", help="processes on this computer (1)"
    )
    parser.add_argument("--out", metavar="DIR", help="folder of Parquet files, created if missing")
    text = "instead compare two campaigns of one seed, docking by docking"
    parser.add_argument("--compare", nargs=2, metavar=("A", "B"), help=text)


def campaign(options: argparse.Namespace) -> output.Result:
    """Run the missing dockings of a campaign and return how its dockings ended, or compare two."""
    if options.compare is not None:
        return _compare(options)
    folder, settings = _folder(options), _settings(options)
    with campaign_errors():
        with output.Interrupts() as interrupts, Store(folder, settings) as store:
            progress = CampaignProgress(settings.n, len(store.done))
            runner.run_missing(store, options.workers or 1, progress, interrupts.event.is_set, output.log_line)
            complete = not store.missing()
        judged = ("broken",) if scene_of(settings.to_json())[1].hostile else ()
        results = read_results(folder, (*COLUMNS, *judged))
    summary = {**summarise(results), "complete": complete, "out": str(folder), "seed": settings.seed, "simulated": True}
    text = _described(summary, settings)
    if complete:
        return output.Result(text, summary)
    rest = f"{folder}: {len(results['number'])} of {settings.n} dockings are written; repeat the command to resume"
    return output.Result(
        text, summary, output.INTERRUPTED if interrupts.number == signal.SIGINT else output.FAILED, [rest]
    )


def _compare(options: argparse.Namespace) -> output.Result:
    """Compare two campaigns docking by docking, and draw the differences."""
    with campaign_errors():
        found = compare.compare_campaigns(*map(Path, options.compare))
    return output.Result(compare.describe(found), found)


@contextlib.contextmanager
def campaign_errors() -> Iterator[None]:
    """Turn CampaignError into CommandError; exit code 2 if the input is wrong."""
    try:
        yield
    except CampaignError as error:
        raise output.CommandError(
            str(error), output.WRONG_INPUT if isinstance(error, CampaignRefused) else output.FAILED
        ) from error


class CampaignProgress:
    """Print the progress of a campaign on stderr: a line at every tenth.

    Args:
        total: dockings.
        begun: dockings that existed before.
    """

    def __init__(self, total: int, begun: int) -> None:
        self._total = total
        self._begun = begun
        self._done = begun
        self._charged = 0
        self._started = time.monotonic()
        self._tell = output.Tenths(begun / total)
        if begun:
            output.log_line(f"{begun} of {total} dockings exist already")

    def __call__(self, rows: Sequence[dict[str, Any]]) -> None:
        """Count written rows."""
        self._done += len(rows)
        self._charged += sum(row["charged"] for row in rows)
        run = self._done - self._begun
        rate = run / max(time.monotonic() - self._started, 1e-9)
        left = (self._total - self._done) / rate if rate else 0.0
        line = f"{self._done} of {self._total} dockings, {self._charged} of {run} new ones charged, {rate:.1f} per s"
        self._tell(self._done / self._total, f"{line}, {left:.0f} s left")


def _folder(options: argparse.Namespace) -> Path:
    if not options.out:
        raise output.WrongInput("--out DIR is missing: give the folder for the results")
    folder = Path(options.out)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output.from_os_error(error, f"--out {folder}: {folder.parent} cannot be created: ") from error
    return folder


def _settings(options: argparse.Namespace) -> CampaignSettings:
    with output.wrong_input(SceneError):
        scene = load_campaign_scene(options.scenes)
    count = options.n or len(scene.dockings) or _DEFAULT_COUNT
    if scene.dockings and count > len(scene.dockings):
        raise output.WrongInput(
            f"-n {count}: {scene.file} lists {len(scene.dockings)} dockings; give at most that number"
        )
    return CampaignSettings(count, options.seed, options.exact, scene.content, scene.name, versions())


def _described(summary: dict[str, Any], settings: CampaignSettings) -> str:
    low, high = summary["charged_interval"]
    refused = ", ".join(f"{name} {count}" for name, count in summary["refused"].items())
    lines = [
        f"{summary['n']} simulated dockings of '{settings.scene_name}', seed {settings.seed}",
        f"  charged            {100 * summary['charged']:.1f} % (95 %: {100 * low:.1f} to {100 * high:.1f})",
        f"  aligned            {100 * summary['aligned']:.1f} %",
        f"  refused            {refused or 'none'}",
        f"  shorts             {summary['shorts']}; {summary['energised_unsafe']:.3f} s live without clearance",
    ]
    for name, scale, unit in (
        ("time", 1.0, "s"),
        ("moves", 1.0, ""),
        ("final_misalignment", 1e3, "mm"),
        ("peak_push", 1.0, "N"),
        ("time_above_band", 1.0, "s"),
    ):
        values = ", ".join(f"{key} {scale * value:.2f}" for key, value in summary[name].items())
        lines.append(f"  {name:<18} {values} {unit}".rstrip())
    if "broken" in summary:
        laws = ", ".join(f"{name} {count}" for name, count in summary["broken"].items())
        lines.append(f"  laws broken        {laws or 'none'}")
    if summary["crashed"]:
        lines.append(f"  crashed            {summary['crashed']}; see the column error")
    return "\n".join(lines)
