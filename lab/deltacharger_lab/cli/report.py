# SPDX-License-Identifier: Apache-2.0
"""`deltacharger report`: measure a part, write a page with tables and pictures, print which targets are met."""

from __future__ import annotations

import argparse
import signal
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from deltacharger_bringup.cli.files import folder_to_write
from deltacharger_bringup.cli.output import (
    DONE,
    FAILED,
    INTERRUPTED,
    CommandError,
    Interrupts,
    log_line,
    print_text,
    write_json,
    wrong_input,
)
from deltacharger_bringup.cli.types import SEED, integer


def add_kinematics(parser: argparse.ArgumentParser) -> None:
    """Add the options of `report kinematics`."""
    _add_common(parser, "report-kinematics", "fewer points and shorter timings")
    points = "points per set, 50 to 100000 (default: 5000, with --quick 200)"
    parser.add_argument("--points", type=integer(50, 100_000), metavar="N", help=points)
    parser.add_argument("--seed", type=SEED, default=1, metavar="S", help="random seed of every set (default: 1)")


def add_tactile(parser: argparse.ArgumentParser) -> None:
    """Add the options of `report tactile` and `tactile compare`."""
    _add_common(parser, "report-tactile", "one rig and few models")
    parser.add_argument("--seed", type=SEED, default=1, metavar="N", help="random seed of the dockings (1)")


def add_vision(parser: argparse.ArgumentParser) -> None:
    """Add the options of `report vision`."""
    _add_common(parser, "report-vision", "a tenth of the images")
    images = "images per row, 2 to 1000 (default: 150, with --quick 15); rows with targets have more"
    parser.add_argument("--images", type=integer(2, 1000), metavar="N", help=images)
    parser.add_argument("--seed", type=SEED, default=0, metavar="N", help="shifts the seeds of all images (default: 0)")


def add_simulation(parser: argparse.ArgumentParser) -> None:
    """Add the options of `report simulation`."""
    _add_common(parser, "report-simulation", "few steps and stiffnesses")


def add_docking(parser: argparse.ArgumentParser) -> None:
    """Add the options of `report docking`."""
    _add_common(parser, "report-docking", "a hundredth of the dockings")
    parser.add_argument(
        "--only", action="append", default=[], metavar="NAME", help="run only this campaign; may be repeated"
    )
    count = "dockings of each campaign (default: as planned, 160 to 20000)"
    parser.add_argument("-n", "--n", type=integer(1, 10_000_000), metavar="N", help=count)
    parser.add_argument("--seed", type=SEED, metavar="S", help="random seed of all campaigns (default: the report's)")
    parser.add_argument(
        "--workers", type=integer(1, 1024), default=1, metavar="K", help="processes on this computer (1)"
    )


def add_footprint(parser: argparse.ArgumentParser) -> None:
    """Add the options of `report footprint`."""
    _add_common(parser, "report-footprint", "once and shorter")
    text = "measure this scene; may be repeated (default: every packaged scene)"
    parser.add_argument("--scene", action="append", default=[], metavar="NAME|FILE", help=text)
    repeats = "runs of each scene and way of starting, 1 to 100 (default: 3, with --quick 1)"
    parser.add_argument("--repeats", type=integer(1, 100), metavar="N", help=repeats)


def _add_common(parser: argparse.ArgumentParser, default: str, quick: str) -> None:
    where = f"folder, created if missing (default: {default})"
    parser.add_argument("--out", default=default, metavar="DIR", help=where)
    parser.add_argument("--quick", action="store_true", help=f"{quick}, for a preview")


def kinematics(options: argparse.Namespace) -> int:
    """Write the report of the kinematics into a folder."""
    from deltacharger_lab.reports.kinematics import report

    count = options.points or (report.QUICK_POINTS if options.quick else report.DEFAULT_POINTS)
    plan = (report.quick_plan if options.quick else report.full_plan)(count, options.seed)
    command = f"{_command(options, 'kinematics')} --points {count} --seed {plan.seed}"
    directory = folder_to_write("--out", options.out)
    results = report.build(plan, directory, command, log_line)
    _print_absent(results["absent"])
    return _end(options, results, directory, "kinematics", ("seed", "points"))


def tactile(options: argparse.Namespace) -> int:
    """Write the comparison of the classifiers of misalignment, on simulated data, into a folder."""
    from deltacharger_lab.reports.tactile import plan as tactile_plan
    from deltacharger_lab.reports.tactile import report

    plan = (tactile_plan.quick_plan if options.quick else tactile_plan.full_plan)(options.seed)
    _print_absent(tactile_plan.absent())
    if not plan.names:
        raise CommandError("no library for training is installed; install deltacharger-lab[train]", FAILED)
    directory = folder_to_write("--out", options.out)
    results = report.build(plan, directory, f"{_command(options, 'tactile')} --seed {options.seed}", log_line)
    return _end(options, results, directory, "tactile", ("simulated", "rigs", "seeds"), "simulated data:")


def vision(options: argparse.Namespace) -> int:
    """Write the report of the electrode detector on simulated images into a folder."""
    from deltacharger_lab.reports.vision import plan as vision_plan
    from deltacharger_lab.reports.vision import report

    plan = vision_plan.plan(options.images, options.seed, options.quick)
    _print_absent(plan.absent)
    if "opencv" in plan.absent:
        raise CommandError(f"OpenCV is absent: {plan.absent['opencv']}", FAILED)
    directory = folder_to_write("--out", options.out)
    command = f"{_command(options, 'vision')} --images {plan.images} --seed {plan.seed}"
    results = report.build(plan, directory, command, log_line)
    return _end(options, results, directory, "vision", ("simulated", "seed", "images"), "simulated images:")


def simulation(options: argparse.Namespace) -> int:
    """Write the report of the simulated charger's mechanics into a folder."""
    from deltacharger_lab.reports.simulation import plan as simulation_plan
    from deltacharger_lab.reports.simulation import report, stability

    plan = simulation_plan.QUICK if options.quick else simulation_plan.SimulationPlan()
    _print_absent(simulation_plan.absent())
    directory = folder_to_write("--out", options.out)
    results = report.build(plan, directory, _command(options, "simulation"), log_line)
    return _end(options, results, directory, "simulation", ("models", "quick"), also=(stability.MODULE,))


def docking(options: argparse.Namespace) -> int:
    """Run or resume the campaigns of the docking report, and write it."""
    from deltacharger_lab.cli.campaign import CampaignProgress, campaign_errors
    from deltacharger_lab.reports.docking import plan as docking_plan
    from deltacharger_lab.reports.docking import report as docking_report

    with wrong_input(ValueError, before="--only: "):
        plan = docking_plan.make_plan(options.quick, options.only, options.n, options.seed)
    directory = folder_to_write("--out", options.out)
    command = f"{_command(options, 'docking')} --seed {plan.seed}"

    def progress(part: docking_plan.CampaignPart, total: int, begun: int) -> CampaignProgress:
        log_line(f"{part.name}: {part.about}")
        return CampaignProgress(total, begun)

    with campaign_errors():
        with Interrupts() as interrupts:
            complete = docking_report.run(plan, directory, options.workers, progress, interrupts.event.is_set, log_line)
        if not complete:
            log_line(f"{directory}: interrupted; repeat the command to resume")
            return INTERRUPTED if interrupts.number == signal.SIGINT else FAILED
        results = docking_report.build(plan, directory, command, log_line)
    more = ("simulated", "seed", "quick", "not_run")
    return _end(options, results, directory, "docking", more, "simulated dockings:")


def footprint(options: argparse.Namespace) -> int:
    """Write the report of the resources that each scene needs into a folder."""
    from deltacharger_bringup.cli.charger import require_domain, ros_context
    from deltacharger_bringup.cli.scene import refusing_scenes
    from deltacharger_core import environment
    from deltacharger_lab.reports.footprint import plan as footprint_plan
    from deltacharger_lab.reports.footprint import process as footprint_process

    unsupported = footprint_process.unsupported()
    if unsupported:
        raise CommandError(unsupported, FAILED)
    with refusing_scenes("--scene: "):
        plan = footprint_plan.make_plan(options.scene, options.quick, options.repeats)
    for name, reason in plan.left_out.items():
        log_line(f"{name} is left out: {reason}")
    if not plan.scenes:
        raise CommandError(f"nothing to measure: {'; '.join(f'{name}: {why}' for name, why in plan.left_out.items())}")
    directory = folder_to_write("--out", options.out)
    environment.prepare()
    require_domain()
    environment.isolate()
    scenes = "".join(f" --scene {name}" for name in options.scene)
    command = f"{_command(options, 'footprint', scenes)} --repeats {plan.repeats}"
    with ros_context() as context:
        from deltacharger_lab.reports.footprint import report as footprint_report

        results = footprint_report.build(plan, context, directory, command, log_line)
    return _end(options, results, directory, "footprint", ("rows", "left_out", "quick", "repeats"))


def _command(options: argparse.Namespace, subject: str, words: str = "") -> str:
    """Return the command that writes the report again."""
    return f"deltacharger report {subject}{words}{' --quick' if options.quick else ''}"


def _print_absent(absent: Mapping[str, str]) -> None:
    for name, reason in absent.items():
        log_line(f"{name} is absent: {reason}")


def _end(
    options: argparse.Namespace,
    results: dict[str, Any],
    directory: Path,
    subject: str,
    more: tuple[str, ...],
    of_what: str = "",
    also: tuple[str, ...] = (),
) -> int:
    """Print the written files, the main one first, and which targets are met."""
    for name, reason in results["missing_pictures"].items():
        log_line(f"no picture {name}: {reason}")
    files = [path for kind in ("html", "md", "json") if (path := directory / f"{subject}.{kind}").exists()]
    log_line(f"{files[0]}: written in {results['elapsed_s']:.0f} s")
    if options.json:
        written = [*map(str, files), *(str(directory / name) for name in (*also, *results["pictures"]))]
        keys = ("targets", "absent", "missing_pictures", "elapsed_s", *more)
        write_json({"success": True, "files": written, **{key: results[key] for key in keys}})
        return DONE
    if of_what:
        print_text(of_what)
    for target in results["targets"]:
        verdict = "not measured" if target["met"] is None else "met" if target["met"] else "NOT MET"
        print_text(
            f"{target['name']:<52} {target['wanted']:>9}  {target['measured']:>10.3g} {target['unit']:<8} {verdict}"
        )
    return DONE
