# SPDX-License-Identifier: Apache-2.0
"""Basis of the docking report: where each threshold was chosen, and the headline figures in other worlds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from deltacharger_core.parameters import declared
from deltacharger_docking.parameters import DockingParameters

CHOSEN = (5, 19)
"""Seeds of the campaigns on which docking's rules and thresholds were chosen; the report uses another."""


class Choice(NamedTuple):
    """Docking parameters chosen together."""

    names: tuple[str, ...]
    where: str


_SEEDS = " and ".join(map(str, CHOSEN))
CHOICES = (
    Choice(
        ("critical_angle", "electrode_half_gap", "electrode_half_length"),
        "no seed: the paper's critical angle, and electrodes with that angle",
    ),
    Choice(
        ("clearance_min", "clearance_sigmas", "clearance_sigmas_sure", "clearance_contacts"),
        "no seed: the formula of the clearance, and a rate of unsafe acts by the normal distribution and its tails",
    ),
    Choice(("current_min", "current_max", "alignments_max"), "no seed: the paper"),
    Choice(("docking_jitter",), "rigs 500–509 of the pads' generator, fitted to the paper's accuracies"),
    Choice(
        (
            *("landing_limit", "overlap_loss_max", "redocking_gain_min", "alignment_tolerance"),
            *("horizontal_scale", "horizontal_shared", "gain_error"),
        ),
        f"seeds {_SEEDS}",
    ),
    Choice(
        ("magnet_force", "magnet_width", "magnet_floor", "pad_distance"),
        "no seed: the world's and the pads' generator's assumptions about magnets and pads",
    ),
    Choice(("pad_yaw_stiffness",), "no seed: slope of the tactile contact model at 78 N, 690 N·m/rad"),
    Choice(("load_per_yaw",), "no seed: the pads' generator, which tilts by 10° per metre of horizontal offset"),
    Choice(
        ("force_repeatability", "force_error", "magnet_error", "magnet_width_error"),
        "no seed: hysteresis of a pad by its data sheet (4 to 4.5 %); spread of gains and magnets in the pads' "
        "generator (5 %), set a little higher; the width by judgement",
    ),
    Choice(
        ("platform_compliance", "yaw_stddev", "place_stddev"),
        "no seed: the middle of the campaigns' range (0.01 to 0.03 rad/(N·m)), and the accuracy of a robot's place "
        "and of a goal's pose; differs for each charger and site",
    ),
    Choice(
        ("yaw_max", "pitch_max", "lean_sigmas", "pitch_shift"),
        "leaning contacts of the world and of the pose model at up to 5°, then seed 5",
    ),
    Choice(
        ("probe_offset", "probe_gain_min", "aligned_risk_max", "load_share_max", "pad_force_min"),
        "seed 5, on `lean2`, `lean5` and `rigid`",
    ),
    Choice(
        (
            *("approach_speed", "travel_speed", "search_speed", "press_speed"),
            *("search_from", "near", "lift", "settle_touching", "drift_max"),
        ),
        f"a trial on seeds of the family 777001, then seeds {_SEEDS}",
    ),
    Choice(("run_up", "run_up_speed"), "seeds 5 and 43; so was the magnets' draw along the bars, in code"),
    Choice(
        (
            "band_margin",
            "aim_below",
            "step_share",
            "step_near",
            "overshoot_back_off",
            "push_current",
            "release_current",
        ),
        f"statics of the arm, then seeds {_SEEDS}",
    ),
    Choice(
        ("ease_current_max", "ease_spared_max", "slip_max", "slip_undo_share"),
        "earlier campaigns whose seeds were not kept; ease_current_max was once moved to 0.57 A to meet a target",
    ),
    Choice(
        ("contradiction_start", "contradiction_each", "unsure_max", "unsure_move_sigmas", "roll_sigmas"),
        "earlier campaigns whose seeds were not kept",
    ),
)


def thresholds() -> Iterator[tuple[str, str]]:
    """Yield each group of thresholds with present values and where they were chosen."""
    known = {each.name: each for each in declared(DockingParameters)}
    for choice in CHOICES:
        values = (f"{name} {known[name].default:.4g} {known[name].unit}".rstrip() for name in choice.names)
        yield ", ".join(values), choice.where


class OtherWorld(NamedTuple):
    """A campaign to compare with the one of a headline."""

    name: str
    about: str


WORLDS = (
    OtherWorld("default", "the headline's conditions"),
    OtherWorld("strike", "every tick and frame computed"),
    OtherWorld("real_arm", "an arm as others measured theirs"),
    OtherWorld("worn_arm", "the same arm, worn"),
    OtherWorld("yielding", "robots that give way"),
    OtherWorld("random", "everything at once"),
    OtherWorld("second", "contact physics that no estimator has seen"),
    OtherWorld("second_1N", "the same, by the pose model for sensors from 1 N on"),
    OtherWorld("second_sensitive", "that physics, sheets that read forces from 0.25 N on"),
    OtherWorld("random_second", "`random` on that physics"),
    OtherWorld("assumed_stiffness", "assumed servo stiffness wrong by up to a factor of 4"),
    OtherWorld("assumed_stiffness_exact", "the same, every tick and frame computed"),
    OtherWorld("assumed_torque_constant", "assumed torque constant wrong by 20 %"),
    OtherWorld("assumed_gravity", "assumed gravity wrong by up to 10°"),
    OtherWorld("assumed_geometry", "assumed geometry of the arm wrong"),
    OtherWorld("high_row", "a row of taxels reads high after the tare"),
    OtherWorld("parked", "the robot stands askew by up to 5°"),
    OtherWorld("nudged", "the target is moved while it charges"),
    OtherWorld("rigid", "the platform does not yield"),
    OtherWorld("lean2", "the target's faces yawed by up to 2°"),
    OtherWorld("lean5", "yawed and pitched by up to 5° each, springs of 3e4 and 1e5 N/m"),
    OtherWorld("lean5_stiff", "the same, springs of 3e5 N/m"),
    OtherWorld("second_upright", "`upright` on the contact physics that no estimator has seen"),
    OtherWorld("lean2_second", "`lean2` on that physics"),
    OtherWorld("lean5_second", "`lean5` on that physics"),
)
"""The campaigns of the table "What the headlines rest on", if they were run."""


def worlds(parts: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[OtherWorld, Mapping[str, Any]]]:
    """Yield each campaign that was run, with its summary."""
    for world in WORLDS:
        if world.name in parts:
            yield world, parts[world.name]
