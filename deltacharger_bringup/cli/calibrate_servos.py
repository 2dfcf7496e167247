# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate servos`: measure the servos of a running charger with its own arm."""

import argparse
import dataclasses
import datetime
import math
from typing import Any

from deltacharger_bringup.cli import arguments, calibrate_kinematics, charger, output
from deltacharger_core import parameters, servo_types, yaml_file
from deltacharger_kinematics.calibration import servo_fit, servo_procedure
from deltacharger_kinematics.calibration.servo_procedure import measure_servos

_HEADS, _UNITS = ("servo 1", "servo 2", "servo 3", "arm"), ("N·m/rad", "N·m/A", "N·m", "N·m·s/rad")


def add_servos(parser: argparse.ArgumentParser) -> None:
    """Add the options of `calibrate servos`."""
    add = parser.add_argument
    usual = servo_fit.ServoTask()
    add("--out", metavar="FILE", help="write the measured values, for the parameter servos_file")
    add("--geometry", metavar="FILE", help="the arm's geometry (default: docking_node's)")
    add("--force", action="store_true", help="overwrite the file, and write doubtful numbers")
    text = "standard deviation of the weight of platform and rods (2)"
    add(
        "--weight-percent",
        type=arguments.between(0.1, 20.0),
        default=100.0 * usual.weight_tolerance,
        metavar="P",
        help=text,
    )
    add(
        "--seconds",
        type=arguments.between(60.0, 1800.0),
        default=usual.seconds,
        metavar="S",
        help="how long to measure (150)",
    )
    add("--seed", type=arguments.SEED, default=0, metavar="N", help="random seed of the order of the poses (0)")
    arguments.namespace_option(parser)


def servos(options: argparse.Namespace) -> output.Result:
    """Measure the servos of the running charger, print and write the values."""
    if options.out is not None:
        arguments.file_to_write("--out", options.out, overwrite=options.force)
    if options.geometry is not None:
        calibrate_kinematics.geometry_of(options.geometry)  # checked before anything moves
    charger.prepare(options, look_around=True)
    task, gains, measured = _measured(options)
    remarks = servo_procedure.differing(measured)
    problems = servo_procedure.doubts(measured, gains)
    try:
        found: servo_types.MeasuredServos | None = servo_procedure.to_file(measured, gains)
    except parameters.ParameterError as error:
        found, problems = None, problems or [str(error)]

    def save(path: str) -> None:
        if found is None:
            raise output.CommandError(f"{problems[0]}; these values cannot be written")
        yaml_file.write_yaml(path, dataclasses.asdict(found), _header(task, measured, problems))

    value = {**servo_procedure.figures(measured), **_about(measured), "doubts": problems}
    return output.conclude(options, bool(problems), save, _as_text(measured), value, [*problems, *remarks])


def _measured(
    options: argparse.Namespace,
) -> tuple[servo_fit.ServoTask, servo_procedure.Gains, servo_procedure.MeasuredArm]:
    """Measure the arm. Its torque is off afterwards, unless docking_node has taken control of it."""
    with output.Interrupts() as interrupts, charger.ros_context() as context:
        from deltacharger_bringup.records.arm_client import ArmError, MeasuringArm

        arm = MeasuringArm(
            context, calibrate_kinematics.geometry_of(options.geometry), options.namespace, interrupts.event
        )
        try:
            with arm:
                arm.wait_until_ready(charger.DISCOVERY)
                task, gains = _task(options, arm.parameters_of("docking_node"), arm.parameters_of("servo_node"))
                arm.start()
                output.log_line(
                    f"the arm moves for up to {math.ceil((task.seconds + 15.0) / 60.0)} minutes; Ctrl-C ends it"
                )
                measured = measure_servos(arm, task, output.Tenths())
                try:
                    arm.retire(measured.fit.common(servo_fit.STIFFNESS)[0])
                except ArmError as error:
                    if interrupts.event.is_set():
                        raise
                    output.log_line(f"the arm did not go home: {error}")
        except (ArmError, servo_fit.ServoTrouble) as error:
            ended = ", and the torque is off" if arm.is_released else ""
            raise output.CommandError(f"{error}; nothing was written{ended}", interrupts.failure) from error
    return task, gains, measured


def _task(
    options: argparse.Namespace, docking: dict[str, Any], servo: dict[str, Any]
) -> tuple[servo_fit.ServoTask, servo_procedure.Gains]:
    """Return arm, gravity and gains as the nodes report them.

    Raises:
        CommandError: servo_node does not report its gains; docking_node's file cannot be read here.
    """
    from deltacharger_bringup.records.node_parameters import docking_settings

    if not docking:
        output.log_line("docking_node does not report geometry and gravity; using the nominal ones")
    try:
        gains = servo_procedure.Gains(*(int(servo[f"position_{name}_gain"]) for name in ("p", "d")))
        constant = float(servo["torque_constant"])
    except KeyError as error:
        raise output.CommandError("servo_node does not report its gains; stiffness depends on them") from error
    if options.geometry is not None:
        docking = {name: value for name, value in docking.items() if name == "gravity"}
    try:
        settings, geometry = docking_settings(docking)
    except OSError as error:
        raise output.CommandError(
            f"docking_node's geometry_file cannot be read here ({error}): give it with --geometry"
        ) from error
    task = servo_fit.ServoTask(
        geometry if options.geometry is None else calibrate_kinematics.geometry_of(options.geometry),
        settings.gravity,
        constant,
        options.weight_percent / 100.0,
        options.seconds,
        options.seed,
    )
    return task, gains


def _header(task: servo_fit.ServoTask, measured: servo_procedure.MeasuredArm, problems: list[str]) -> str:
    """Return the comment with the origin of a file."""
    gravity = ", ".join(f"{value:g}" for value in task.gravity)
    return "\n".join(
        [
            "Servos of one arm, measured by `deltacharger calibrate servos`.",
            f"date: {datetime.datetime.now(datetime.timezone.utc):%Y-%m-%d %H:%M} UTC",
            f"{len(measured.readings)} places in {measured.seconds:.0f} s; scatter {measured.fit.scatter:.2f}",
            f"weight: platform {task.geometry.platform_mass:g} kg, each rod pair {task.geometry.rod_mass:g} kg, "
            f"known to {100.0 * task.weight_tolerance:g} %; gravity ({gravity}) m/s²",
            "stiffness is valid only with the gains below",
            *_table(measured),
            *(f"doubtful: {problem}" for problem in problems),
        ]
    )


def _about(measured: servo_procedure.MeasuredArm) -> dict[str, Any]:
    return {"places": len(measured.readings), "seconds": measured.seconds, "scatter": measured.fit.scatter}


def _as_text(measured: servo_procedure.MeasuredArm) -> str:
    return "\n".join(
        [
            *_table(measured),
            "",
            f"{len(measured.readings)} places in {measured.seconds:.0f} s",
            f"scatter {measured.fit.scatter:.2f} of what noise and ticks explain",
            f"friction takes {100.0 * measured.fit.friction_share:.0f} % of the torque besides",
        ]
    )


def _table(measured: servo_procedure.MeasuredArm) -> list[str]:
    rows = [f"{'':<26}" + "".join(f"{head:>18}" for head in _HEADS)]
    for (name, cells), unit in zip(servo_procedure.figures(measured).items(), _UNITS, strict=True):
        rows.append(f"{name.replace('_', ' '):<16}{unit:<10}" + "".join(f"{_cell(*cell):>18}" for cell in cells))
    return rows


def _cell(value: float, error: float) -> str:
    if not math.isfinite(value):
        return "unknown"
    digits = max(0, 1 - math.floor(math.log10(error))) if error > 0.0 else 3
    return f"{value:.{digits}f} ± {error:.{digits}f}"
