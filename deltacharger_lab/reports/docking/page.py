# SPDX-License-Identifier: Apache-2.0
"""The page of the docking report."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from deltacharger_lab.reports.docking import page_figures as figures
from deltacharger_lab.reports.docking import summary
from deltacharger_lab.reports.docking.pictures import FORMS, NAMES
from deltacharger_lab.reports.docking.text import causes, number, share, show
from deltacharger_lab.reports.page_text import prose, table


def write_page(results: dict[str, Any], path: Path) -> None:
    """Write the page; the pictures lie beside it."""
    parts = (
        *(_head, _targets, _campaigns, _angles, _uncharged, _drawn, _tilts),
        *(figures.safety, figures.zero, figures.load, figures.alignment, figures.errors, figures.engine),
    )
    path.write_text("\n\n".join(block for part in parts for block in part(results)) + "\n", "utf-8")


def _head(results: dict[str, Any]) -> Iterator[str]:
    where = results["machine"]
    codes = ", ".join(f"`{code}`" for code in sorted({each["code"] for each in results["versions"].values()}))
    yield "# Docking: what is charged, what is refused, and what never happens"
    yield prose(
        f"""Written on {results["date"]} by `{results["command"]}` on {where["processor"]} with {where["cores"]} cores,
        {where["system"]}, Python {where["python"]}. **Everything here is simulated**: the real state machine and the
        real estimator against the simulated world, pads and circuit, in virtual time. What is drawn are assumptions;
        nothing has been checked against a real charger."""
    )
    yield prose(
        f"""Every docking follows from seed {results["seed"]} and its number alone, on the code with the digest
        {codes}: `deltacharger campaign --scenes SCENE --seed {results["seed"]} -n N --out DIR` gives the same rows.
        The same command goes on where it was interrupted; with other code it refuses the folder, so that no table
        mixes rows of two versions. Intervals are 95 % (Wilson)."""
    )
    if results["quick"]:
        yield "**A first look with a hundredth of the dockings.** Small counts prove little."
    if results["not_run"]:
        yield f"**Not run yet**: {', '.join(results['not_run'])}; `--only NAME` runs one."


def _targets(results: dict[str, Any]) -> Iterator[str]:
    yield "## Targets"
    rows = []
    for each in results["targets"]:
        verdict = "not measured" if each["met"] is None else "met" if each["met"] else "NOT MET"
        value = "–" if each["met"] is None else f"{each['measured']:.4g}"
        rows.append((each["name"], each["wanted"], value, each["unit"], verdict))
    yield table(("target", "wanted", "measured", "unit", "verdict"), rows)
    yield prose(
        f"""All are of the guarded form with our estimate: `random`, `upright`, `edge` and `soft` together, but the
        first one (`random` and `upright` with |roll| up to {summary.UPRIGHT:g}°), those that name their scenes, the
        moves (`random`) and the crashes (all). No docking was left out."""
    )
    yield prose(
        """Chargeable is every target with magnets inside the ranges below that is rolled by 7° at most; each refusal
        of one counts against the target, whatever its code. `soft` stands apart: without magnets the push of 17 N
        leaves no taxel at the paper's 1 N, so that the docking ends by the paper's own rule. What must be refused (out
        of reach, not there, too far behind) is in `fixed`."""
    )


def _campaigns(results: dict[str, Any]) -> Iterator[str]:
    yield "## The campaigns"
    parts = results["parts"]
    rows = []
    for part in results["plan"]:
        each = parts[part["name"]]
        rows.append(
            (
                part["name"],
                part["about"],
                _count(part),
                share(each["charged"]),
                share(each["near"]),
                number(each["moves"]["median"], 0),
                number(each["time"]["median"], 1),
                causes(each["refused"]),
            )
        )
    head = ("campaign", "what", "dockings", "charged, %", "of these within 2.5 mm, %", "moves", "s", "refused")
    yield table(head, rows)
    yield prose(
        """What is drawn stands in config/campaigns/*.yaml. `random`: targets within ±20 mm in x and y and ±8 mm in z;
        of errors of camera (0.8 mm, 0.23°) and mount (3 mm and 1° per axis, a centimetre in all, as the paper has it
        near the target) and of a target that has moved by up to ±10 mm, at most 10 mm are left at contact in x and y;
        roll ±20°, of which the camera is taken to see nothing; faces tilted by ±0.1° against the platform, which
        yields by 0.01 to 0.03 rad/(N·m); contact stiffness 1e4 to 1e7 N/m per electrode, logarithmic; servo stiffness
        2.5 to 20 N·m/rad; gravity from anywhere, known to docking; friction, magnets and pads with the spread of
        `default`. Moves and seconds are medians of the charged."""
    )


def _count(part: dict[str, Any]) -> str:
    return f"{part['run']}" if part["run"] >= part["count"] else f"{part['run']} of {part['count']}"


def _angles(results: dict[str, Any]) -> Iterator[str]:
    yield "## By angle"
    parts = results["parts"]
    names = [name for name in FORMS if name in parts]
    found = {
        name: {(each["low"], each["high"]): each for each in parts[name]["bins"]}
        for name in (*names, "edge")
        if name in parts
    }
    bins = sorted({key for each in found.values() for key in each})
    columns = [name for name in ("edge", *names) if name in found]
    head = [
        "roll, °",
        *(f"{'`edge`, guarded' if name == 'edge' else FORMS[name][0]}, charged %" for name in columns),
        "guarded, refused",
    ]
    rows = []
    for low, high in bins:
        cells = [share(found[name][low, high]) if (low, high) in found[name] else "–" for name in columns]
        source = next(
            (found[name][low, high] for name in ("edge", "random") if (low, high) in found.get(name, {})), None
        )
        rows.append((f"{low:g}–{high:g}", *cells, causes(source["refused"]) if source else "–"))
    yield table(head, rows)
    yield prose(
        """The paper's form is Algorithm 1 with steps of 5 mm; its classes are those of its CNN, trained on its
        protocol (1100 dockings on each of 20 simulated rigs) and used on rigs that it has not seen. They tell no angle
        above 5° and no doubt, so the rule of clearance, which holds in every form, is fed with classes as if they were
        certain. Where they let the wrong bars touch, it is the probe that finds it (SHORT_CIRCUIT) before the
        contactor closes; the paper's hardware has none."""
    )
    yield show(results, NAMES[0])
    for pair in results["pairs"]:
        if "exact" not in pair["names"]:
            yield _pair(pair)


def _pair(pair: dict[str, Any]) -> str:
    a, b = pair["names"]
    charged, time = pair["rates"]["charged"], pair["numbers"]["time"]
    low, high = charged["interval"]
    slow, fast = time["interval"]
    unsafe, shorts = pair["energised_unsafe"], pair["shorts"]
    return prose(
        f"""**{b}** less **{a}** on {pair["pairs"]} of the same dockings: charged {100.0 * charged["difference"]:+.1f}
        points ({100.0 * low:+.1f} to {100.0 * high:+.1f}), time {time["difference"]:+.1f} s ({slow:+.1f} to
        {fast:+.1f}) where both charge, live without clearance {unsafe["a"]:.2f} → {unsafe["b"]:.2f} s, shorts
        {shorts["a"]} → {shorts["b"]}."""
    )


def _uncharged(results: dict[str, Any]) -> Iterator[str]:
    if results["upright"] is None:
        return
    yield f"### Upright and not charged (|roll| ≤ {summary.UPRIGHT:g}°)"
    if not results["uncharged"]:
        yield f"None of {results['upright']['n']}."
        return
    each = results["upright"]
    yield prose(
        f"""{each["n"] - each["charged"]["hits"]} of {each["n"]}: {causes(each["refused"])}. All of them count as
        chargeable and against the target: none was excused. The first ones, to be run again by seed and number:"""
    )
    yield table(
        ("campaign", "number", "roll, °", "code", "what docking said"),
        [
            (
                row["campaign"],
                f"{row['number']}",
                f"{row['degrees']:.1f}",
                row["code_name"],
                row["message"].replace("|", "\\|"),
            )
            for row in results["uncharged"][:25]
        ],
    )


def _drawn(results: dict[str, Any]) -> Iterator[str]:
    yield "### By what was drawn"
    yield prose(
        f"""The upright ones of `random` and `upright` (|roll| ≤ {summary.UPRIGHT:g}°), in thirds of each range;
        offset: the larger one at contact; gravity: its share along the direction of the push, which it works against
        where negative."""
    )
    rows = [
        (
            each["name"],
            each["range"],
            str(each["n"]),
            share(each["charged"]),
            share(each["near"]),
            number(each["time"], 1),
            number(each["moves"], 0),
            number(each["hottest"], 3),
        )
        for each in results["drawn"]
    ]
    yield table(("drawn", "range", "n", "charged, %", "within 2.5 mm, %", "s", "moves", "hottest servo, 99 %, A"), rows)


def _tilts(results: dict[str, Any]) -> Iterator[str]:
    if not results["tilts"]:
        return
    yield "### Tilted faces"
    yield prose(
        """A face that is tilted about y loads one pad more than the other, which the pads cannot tell from a
        horizontal offset; docking then rests beside the centre by what it feels wrongly. It costs contact area and no
        clearance: that hangs on the vertical offset and the angle. `tilted`, by the tilt about y:"""
    )
    yield table(
        ("tilt, °", "n", "charged, %", "within 2.5 mm, %", "horizontal error of the last estimate, mm rms"),
        [
            (
                f"{each['low']:g}–{each['high']:g}",
                str(each["n"]),
                share(each["charged"]),
                share(each["near"]),
                number(each["error"], 2),
            )
            for each in results["tilts"]
        ],
    )
    yield prose(
        """The platform yields by 0.01 to 0.03 rad/(N·m) in these scenes; a rigid one on electrodes of 1e6 N/m would be
        misled by 4 mm from 0.1° on. A constant tilt of a device is what `deltacharger calibrate tactile` takes off."""
    )
