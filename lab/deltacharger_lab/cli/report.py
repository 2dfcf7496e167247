# SPDX-License-Identifier: Apache-2.0
"""`deltacharger report`: measure a part, write a page with tables and pictures, print which targets are met."""

import argparse
import signal
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from deltacharger_bringup.cli import arguments, output

_OF = {
    "kinematics": ("error against run time of inverse and forward kinematics", "seed"),
    "tactile": ("compare classifiers of misalignment on simulated data", "seed"),
    "vision": ("the electrode detector on simulated images", "images seed"),
    "simulation": ("error against run time, stability and energy of the simulated mechanics", ""),
    "docking": ("thousands of simulated dockings; repeat the command to resume", "n only seed workers"),
    "footprint": ("processes, memory and CPU that each scene needs (Linux)", "repeats scene"),
}
"""What each report measures, and its own options."""


def add_report(parser: argparse.ArgumentParser) -> None:
    """Add the options of `report`."""
    about = "; ".join(f"{subject}: {text}" for subject, (text, _) in _OF.items())
    parser.add_argument("subject", choices=_OF, metavar="SUBJECT", help=about)
    parser.add_argument("--out", metavar="DIR", help="folder, created if missing (default: report-SUBJECT)")
    parser.add_argument("--quick", action="store_true", help="a hundredth to a tenth of the work, for a preview")

    def own(flag: str, text: str, **more: Any) -> None:
        name = flag.rpartition("-")[2]
        subjects = ", ".join(subject for subject, (_, options) in _OF.items() if name in options.split())
        parser.add_argument(flag, help=f"{subjects}: {text}", **more)

    own("--seed", "random seed (default: the report's)", type=arguments.SEED, metavar="S")
    own("--images", "images per row (150, with --quick 15)", type=arguments.integer(2, 1000), metavar="N")
    own(
        "-n", "dockings of each campaign (as planned, 160 to 20000)", type=arguments.integer(1, 10_000_000), metavar="N"
    )
    own("--only", "run only this campaign; may be repeated", action="append", metavar="NAME")
    own("--workers", "processes on this computer (1)", type=arguments.integer(1, 1024), metavar="K")
    own("--scene", "measure this scene; may be repeated (every packaged one)", action="append", metavar="NAME|FILE")
    own(
        "--repeats",
        "runs of each scene and way of starting (3, with --quick 1)",
        type=arguments.integer(1, 100),
        metavar="N",
    )


def report(options: argparse.Namespace) -> output.Result:
    """Measure the subject and write its page."""
    own = _OF[options.subject][1].split()
    for name in sorted({name for _, names in _OF.values() for name in names.split()} - set(own)):
        if getattr(options, name) is not None:
            flag = f"-{name}" if len(name) == 1 else f"--{name}"
            raise output.WrongInput(f"{flag} is not an option of report {options.subject}")
    options.out = options.out or f"report-{options.subject}"
    if options.seed is None:
        options.seed = {"kinematics": 1, "tactile": 1, "vision": 0}.get(options.subject)
    write = {
        "kinematics": _kinematics,
        "tactile": _tactile,
        "vision": _vision,
        "simulation": _simulation,
        "docking": _docking,
        "footprint": _footprint,
    }
    return write[options.subject](options)


def _kinematics(options: argparse.Namespace) -> output.Result:
    """Write the report of the kinematics into a folder."""
    from deltacharger_lab.reports.kinematics import report

    directory = arguments.folder_to_write("--out", options.out)
    plan = report.make_plan(options.seed, options.quick)
    results = report.build(plan, directory, f"{_command(options)} --seed {options.seed}", output.log_line)
    _print_absent(results["absent"])
    return _end(options, results, directory, ("seed", "points"))


def _tactile(options: argparse.Namespace) -> output.Result:
    """Write the comparison of the classifiers of misalignment, on simulated data, into a folder."""
    from deltacharger_lab.reports.tactile import plan as tactile_plan, report

    plan = (tactile_plan.quick_plan if options.quick else tactile_plan.full_plan)(options.seed)
    _print_absent(tactile_plan.absent())
    if not plan.names:
        raise output.CommandError("no library for training is installed; install deltacharger-lab[train]")
    directory = arguments.folder_to_write("--out", options.out)
    results = report.build(plan, directory, f"{_command(options)} --seed {options.seed}", output.log_line)
    return _end(options, results, directory, ("simulated", "rigs", "seeds"), "simulated data:")


def _vision(options: argparse.Namespace) -> output.Result:
    """Write the report of the electrode detector on simulated images into a folder."""
    from deltacharger_lab.reports.vision import report

    plan = report.plan(options.images, options.seed, options.quick)
    _print_absent(plan.absent)
    if "opencv" in plan.absent:
        raise output.CommandError(f"OpenCV is absent: {plan.absent['opencv']}")
    directory = arguments.folder_to_write("--out", options.out)
    command = f"{_command(options)} --images {plan.images} --seed {plan.seed}"
    results = report.build(plan, directory, command, output.log_line)
    return _end(options, results, directory, ("simulated", "seed", "images"), "simulated images:")


def _simulation(options: argparse.Namespace) -> output.Result:
    """Write the report of the simulated charger's mechanics into a folder."""
    from deltacharger_lab.reports.simulation import report, scenes

    plan = scenes.QUICK if options.quick else scenes.SimulationPlan()
    _print_absent(scenes.absent())
    directory = arguments.folder_to_write("--out", options.out)
    results = report.build(plan, directory, _command(options), output.log_line)
    return _end(options, results, directory, ("models", "quick"))


def _docking(options: argparse.Namespace) -> output.Result:
    """Run or resume the campaigns of the docking report, and write it."""
    from deltacharger_lab.cli.campaign import CampaignProgress, campaign_errors
    from deltacharger_lab.reports.docking import plan as docking_plan, report as docking_report

    with output.wrong_input(ValueError, before="--only: "):
        plan = docking_plan.make_plan(options.quick, options.only or [], options.n, options.seed)
    directory = arguments.folder_to_write("--out", options.out)
    command = f"{_command(options)} --seed {plan.seed}"

    def progress(part: docking_plan.CampaignPart, total: int, begun: int) -> CampaignProgress:
        output.log_line(f"{part.name}: {part.about}")
        return CampaignProgress(total, begun)

    with campaign_errors():
        with output.Interrupts() as interrupts:
            stop, workers = interrupts.event.is_set, options.workers or 1
            complete = docking_report.run(plan, directory, workers, progress, stop, output.log_line)
        if not complete:
            code = output.INTERRUPTED if interrupts.number == signal.SIGINT else output.FAILED
            raise output.CommandError(f"{directory}: interrupted; repeat the command to resume", code)
        results = docking_report.build(plan, directory, command, output.log_line)
    more = ("simulated", "seed", "quick", "not_run")
    return _end(options, results, directory, more, "simulated dockings:")


def _footprint(options: argparse.Namespace) -> output.Result:
    """Write the report of the resources that each scene needs into a folder."""
    from deltacharger_bringup.cli.charger import require_domain, ros_context
    from deltacharger_bringup.scenes.scene import SceneError
    from deltacharger_core import environment
    from deltacharger_lab.reports.footprint import measure as footprint

    scenes = options.scene or []
    unsupported = footprint.unsupported()
    if unsupported:
        raise output.CommandError(unsupported)
    with output.wrong_input(SceneError, before="--scene: "):
        plan = footprint.make_plan(scenes, options.quick, options.repeats)
    for name, reason in plan.left_out.items():
        output.log_line(f"{name} is left out: {reason}")
    if not plan.scenes:
        raise output.CommandError(
            f"nothing to measure: {'; '.join(f'{name}: {why}' for name, why in plan.left_out.items())}"
        )
    directory = arguments.folder_to_write("--out", options.out)
    environment.prepare()
    require_domain()
    environment.isolate()
    words = "".join(f" --scene {name}" for name in scenes)
    command = f"{_command(options, words)} --repeats {plan.repeats}"
    with ros_context() as context:
        from deltacharger_lab.reports.footprint import report as footprint_report

        results = footprint_report.build(plan, context, directory, command, output.log_line)
    return _end(options, results, directory, ("rows", "left_out", "quick", "repeats"))


def _command(options: argparse.Namespace, words: str = "") -> str:
    """Return the command that writes the report again."""
    return f"deltacharger report {options.subject}{words}{' --quick' if options.quick else ''}"


def _print_absent(absent: Mapping[str, str]) -> None:
    for name, reason in absent.items():
        output.log_line(f"{name} is absent: {reason}")


def _end(
    options: argparse.Namespace,
    results: dict[str, Any],
    directory: Path,
    more: tuple[str, ...],
    of_what: str = "",
    also: tuple[str, ...] = (),
) -> output.Result:
    """Return the written files, the main one first, and which targets are met."""
    remarks = [f"no picture {name}: {reason}" for name, reason in results["missing_pictures"].items()]
    files = [path for kind in ("md", "json") if (path := directory / f"{options.subject}.{kind}").exists()]
    remarks.append(f"{files[0]}: written in {results['elapsed_s']:.0f} s")
    written = [*map(str, files), *(str(directory / name) for name in (*also, *results["pictures"]))]
    keys = ("targets", "absent", "missing_pictures", "elapsed_s", *more)
    lines = [of_what] if of_what else []
    for target in results["targets"]:
        verdict = "not measured" if target["met"] is None else "met" if target["met"] else "NOT MET"
        lines.append(
            f"{target['name']:<52} {target['wanted']:>9}  {target['measured']:>10.3g} {target['unit']:<8} {verdict}"
        )
    return output.Result("\n".join(lines), {"files": written, **{key: results[key] for key in keys}}, remarks=remarks)
