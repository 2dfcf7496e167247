# SPDX-License-Identifier: Apache-2.0
"""The page of the vision report: tables and sentences made from its figures alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from deltacharger_lab.reports.page_text import prose, table
from deltacharger_lab.reports.vision import conditions, pictures
from deltacharger_lab.reports.vision.conditions import ALARMS, CONDITIONS, Condition, key, members
from deltacharger_lab.reports.vision.summary import at_most

_CAPTIONS = {
    pictures.RANGE: "Error across, along and of roll against range, simulated images",
    pictures.FOUND: "Share of images in which the electrodes were found, by defect, simulated images",
    pictures.ERROR_TIME: "Error against run time at three sizes of the image, simulated images",
    pictures.RENDERERS: "The same scenes by both renderers with detections, simulated images",
    pictures.GALLERY: "Hard images with detections, simulated images",
}
_HEAD = ("simulated images", "images", "found, %", "wrong, %", "across, mm", "along, mm", "roll, °", "NEES")


def write_page(results: dict[str, Any], path: Path) -> None:
    """Write the page of `results` to `path`.

    Raises:
        OSError: the file cannot be written.
    """
    parts = (_head, _targets, _range, _defects, _alarms, _intrinsics, _mount, _cost, _renderers, _gallery, _method)
    blocks = [block for part in parts for block in part(results)]
    path.write_text("\n\n".join(blocks) + "\n", encoding="utf-8")


def _head(results: dict[str, Any]) -> list[str]:
    machine = results["machine"]
    used = ", ".join(f"{name} {version}" for name, version in machine["versions"].items())
    total = sum(row["images"] for row in (*results["rows"].values(), *results["mount"].values()))
    blocks = [
        "# Vision: the electrode detector on simulated images",
        prose(
            f"""**Every figure, table and picture on this page is of simulated images**: {total} of them, drawn by a
            ray-caster and by MuJoCo with the defects of a camera; no real camera took any. Written on
            {results["date"]} by `{results["command"]}` in {results["elapsed_s"] / 60.0:.1f} min, on
            {machine["processor"]} with {machine["cores"]} cores (load {machine["load"]:.1f} at the start),
            {machine["system"]}, Python {machine["python"]}; {used}. Seeds from {results["first_seed"]} on, which served
            no tuning."""
        ),
    ]
    if results["quick"]:
        blocks.append("This is a quick look: few images in each row.")
    missing = [f"- {name}: {reason}" for name, reason in results["absent"].items()]
    missing += [f"- picture {name}: {reason}" for name, reason in results["missing_pictures"].items()]
    return [*blocks, *(["Absent from this run:", "\n".join(missing)] if missing else [])]


def _targets(results: dict[str, Any]) -> list[str]:
    rows = [
        (each["name"], each["wanted"], _number(each["measured"]), each["unit"], _verdict(each["met"]))
        for each in results["targets"]
    ]
    band, alarms = results["band"], results["rows"][f"{ALARMS}: {conditions.CLUTTER}"]
    return [
        "## Targets",
        prose(
            f"""640 × 400 px, exact intrinsics, camera frame, one core. Wrong: off by more than 10 mm or 5°; found: not
            wrong. With 95 % confidence the share of wrong ones is at most
            {100 * at_most(band["wrong"], band["images"]):.2f} % ({band["wrong"]} of {band["images"]} images), that of
            false alarms at most {100 * at_most(alarms["wrong"], alarms["images"]):.2f} % ({alarms["wrong"]} of
            {alarms["images"]})."""
        ),
        table(("simulated images", "wanted", "measured", "unit", "verdict"), rows),
    ]


def _verdict(met: bool | None) -> str:
    return "not measured" if met is None else ("met" if met else "**NOT MET**")


def _range(results: dict[str, Any]) -> list[str]:
    return [
        "## Range",
        _picture(results, pictures.RANGE),
        prose(
            """Errors of right detections, median; 95 %: across the line of sight (x and y of the optical frame
            together), along the optical axis, of roll. NEES is the mean squared error of the position in units of its
            covariance: 3 is right, more is too sure. Below 0.174 m stereo has no depth, and the image alone gives the
            pose."""
        ),
        _rows(results, members(conditions.BY_RANGE)),
    ]


def _defects(results: dict[str, Any]) -> list[str]:
    return [
        "## Light, glare, holes, blur, clutter, hidden bars",
        _picture(results, pictures.FOUND),
        "0.2–0.8 m; hidden bars 0.2–0.6 m; no depth 0.15–0.6 m. One seed is one view in all rows of like ranges.",
        _rows(results, members(conditions.DEFECTS) + members(conditions.HIDDEN)),
    ]


def _alarms(results: dict[str, Any]) -> list[str]:
    rows = []
    for each in members(ALARMS):
        row = results["rows"][key(each)]
        share = f"{100 * row['wrong'] / row['images']:.2f}; ≤ {100 * at_most(row['wrong'], row['images']):.2f}"
        rows.append((each.name, str(row["images"]), str(row["wrong"]), share))
    return [
        "## False alarms",
        prose(
            """Scenes without a terminal of the right size: boxes of all kinds and, in every other scene, parallel
            metal bars; drawn rooms with six decoys each (stripes, pipes, single bars, pairs, grilles, terminals of
            another size). The last column is the share and its upper bound with 95 % confidence. Without depth, two
            bars of the right proportions are electrodes at another range."""
        ),
        table(("simulated images", "images", "false alarms", "%"), rows),
    ]


def _intrinsics(results: dict[str, Any]) -> list[str]:
    return [
        "## Wrong intrinsics and lens distortion",
        prose(
            """0.15–0.35 m. The detector is told a focal length or principal point other than the camera's; where image
            and depth contradict each other it fits the focal length too, which needs depth. A wrong principal point
            shows in nothing and shifts the answer. The covariance holds for exact intrinsics alone, as NEES shows.
            *Known*: the detector is told the lens's distortion; *ignored*: it is told there is none."""
        ),
        _rows(results, members(conditions.INTRINSICS)),
        _rows(results, members(conditions.LENS)),
    ]


def _mount(results: dict[str, Any]) -> list[str]:
    rows = []
    for name, row in results["mount"].items():
        errors = (_pair(row, each) for each in ("camera_mm", "base_mm", "xy_mm", "z_mm", "roll_deg"))
        rows.append((name, str(row["images"]), _share(row["found"], row["images"]), *errors, _nees(row["nees"])))
    head = ("the mount's error", "images", "found, %", "camera, mm", "charger_base, mm")
    return [
        "## The camera's mount",
        prose(
            """The usual mount looks at a target 70–90 mm before charger_base, about 0.23 m from the camera. Its true
            pose is off by a rotation and a shift, normal about and along each axis with these standard deviations, and
            detections are told in charger_base by the pose without them. Median; 95 % of the position's error in the
            camera's frame, in charger_base, there across and along z, and of roll. NEES with the mount's error in the
            covariance. **The mount decides**, not the detector."""
        ),
        table((*head, "x and y, mm", "z, mm", "roll, °", "NEES"), rows),
    ]


def _cost(results: dict[str, Any]) -> list[str]:
    rows = []
    for name, each in results["times"].items():
        condition = CONDITIONS[name]
        figures = (f"{each[part]:.1f}" for part in ("median_ms", "p95_ms", "image_ms"))
        rows.append((condition.name, *figures))
    return [
        "## Run time and size of the image",
        _picture(results, pictures.ERROR_TIME),
        _rows(results, members(conditions.SIZE)),
        prose(
            """Processor time of one detection (the least of three runs), and of making the image, ms, on one core in a
            process of its own with no other work of this report. Depth of all sizes has the noise of a stereo camera
            of 640 × 400 px. MuJoCo draws on the processor here, and on all its cores."""
        ),
        table(("simulated images", "detection, median", "detection, 95 %", "the image, median"), rows),
    ]


def _renderers(results: dict[str, Any]) -> list[str]:
    rows = [each for each in members(conditions.RENDERERS) if key(each) in results["rows"]]
    return [
        "## Two renderers",
        _picture(results, pictures.RENDERERS),
        prose(
            """The same scenes by the ray-caster, which the detector was tuned on, and by MuJoCo's OpenGL rasteriser,
            which casts shadows and has highlights of another form. Noise, blur and depth are spoilt alike."""
        ),
        _rows(results, rows),
    ]


def _gallery(results: dict[str, Any]) -> list[str]:
    return ["## Hard images", _picture(results, pictures.GALLERY)]


def _method(results: dict[str, Any]) -> list[str]:
    return [
        "## How it was measured",
        prose(
            """Poses are drawn as a camera at the usual mount sees a robot that comes and docks: upright within 25°,
            seen from up to 31° above, turned by 8° (standard deviation), wholly in the picture; light from anywhere
            before the terminal. Camera and scene have the default parameters of the simulated camera but where a row
            says otherwise. What the images lack is told on [their page](../simulated-camera.md); real ones are worse.
            Run times are taken last. `vision.json` holds every single image's figures under `raw`, with its seed."""
        ),
    ]


def _rows(results: dict[str, Any], rows: Sequence[Condition]) -> str:
    return table(_HEAD, [_row(each.name, results["rows"][key(each)]) for each in rows])


def _row(name: str, row: dict[str, Any]) -> tuple[str, ...]:
    shares = (_share(row[part], row["images"]) for part in ("found", "wrong"))
    errors = (_pair(row, part) for part in ("xy_mm", "z_mm", "roll_deg"))
    return (name, str(row["images"]), *shares, *errors, _nees(row["nees"]))


def _pair(row: dict[str, Any], name: str) -> str:
    middle, most = row[f"{name}_p50"], row[f"{name}_p95"]
    return "–" if math.isnan(middle) else f"{middle:.2f}; {most:.2f}"


def _share(count: int, of: int) -> str:
    return f"{100.0 * count / of:.1f}"


def _nees(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.1f}" if value < 100.0 else f"{value:.0f}"


def _picture(results: dict[str, Any], name: str) -> str:
    if name in results["pictures"]:
        return f"![{_CAPTIONS[name]}]({name})"
    return f"(No picture {name}: {results['missing_pictures'][name]})"


def _number(value: float) -> str:
    if not math.isfinite(value):
        return "–"
    return f"{value:.0f}" if value == round(value) and abs(value) < 1e6 else f"{value:.3g}"
