# SPDX-License-Identifier: Apache-2.0
"""The campaigns of the docking report: scenes, counts, and forms of the algorithm."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

SEED = 20  # no rule and no threshold was chosen on it
QUICK = 0.01  # of the dockings, in the short report
_FEWEST = 20


@dataclass(frozen=True)
class CampaignPart:
    """One campaign.

    Attributes:
        name: of its folder and of its rows.
        scene: packaged scene.
        count: dockings; of a listed scene at most as many as it lists.
        about: description for the page.
        exact: whether every tick and frame is computed.
    """

    name: str
    scene: str
    count: int
    about: str
    exact: bool = False


@dataclass(frozen=True)
class DockingPlan:
    """One report.

    Attributes:
        parts: all campaigns.
        chosen: names of those to run now; others are read if present.
        seed: of all, so that their dockings are pairs.
        quick: whether it is the short plan.
    """

    parts: tuple[CampaignPart, ...]
    chosen: tuple[str, ...]
    seed: int
    quick: bool


PARTS = (
    CampaignPart("default", "default", 4_000, "one type of charger, careful calibration, rolls up to 5°"),
    CampaignPart("real_arm", "real_arm", 4_000, "`default`, an arm as others measured theirs, with a cable that drags"),
    CampaignPart("worn_arm", "worn_arm", 4_000, "the same, worn gears, 1–2° of play, stronger magnets, a weak supply"),
    CampaignPart(
        "yielding", "yielding", 4_000, "`default`, robots of 5–20 N/mm with play, brakes that slip at 10–100 N"
    ),
    CampaignPart("soft_servos", "soft_servos", 4_000, "`default`, servos of 2.5–6 N·m/rad"),
    CampaignPart("random", "random", 20_000, "everything at once, rolls up to 20°"),
    CampaignPart("upright", "upright", 4_000, "the same, rolls up to 7°"),
    CampaignPart("edge", "edge", 20_000, "the same, rolls of 8–11°"),
    CampaignPart("zero", "zero", 2_000, "rolls within 1° of the one without clearance at the first contact"),
    CampaignPart("soft", "soft", 2_000, "no magnets, electrodes of 1e3 N/m, rolls up to 20°"),
    CampaignPart("seen", "seen", 2_000, "`random`, but the camera sees the roll"),
    CampaignPart("tilted", "tilted", 2_000, "`upright`, faces tilted by up to 1° out of the electrodes' plane"),
    CampaignPart("fixed", "fixed", 160, "the committed list: corners of every range, and what must be refused"),
    CampaignPart("tails", "edge_tails", 2_000, "`edge`, errors of Student's t with 3 degrees of freedom, as wide as σ"),
    CampaignPart(
        "gaussian", "edge_gaussian", 2_000, "`edge`, normal errors exactly as wide as σ: the reference for `tails`"
    ),
    CampaignPart("understated", "edge_understated", 2_000, "`edge`, reported σ 1.5 times too small"),
    CampaignPart("biased", "edge_biased", 2_000, "`edge`, estimates 0.5 mm off in both axes"),
    CampaignPart("published", "published", 2_000, "`random`, the paper's algorithm as printed, with its classes"),
    CampaignPart(
        "assumed_stiffness",
        "assumed_stiffness",
        2_000,
        "`default`, servos of 2–40 N·m/rad, assumed ¼ to 4 times as stiff",
    ),
    CampaignPart(
        "assumed_torque_constant", "assumed_torque_constant", 2_000, "`default`, assumed torque constant wrong by 20 %"
    ),
    CampaignPart("calibrated", "calibrated", 2_000, "the same arms after `deltacharger calibrate servos`"),
    CampaignPart("assumed_gravity", "assumed_gravity", 1_000, "`default`, on slopes of up to 10°, unknown to docking"),
    CampaignPart(
        "assumed_geometry", "assumed_geometry", 1_000, "`default`, arms built inaccurately and not calibrated"
    ),
    CampaignPart("high_row", "high_row", 2_000, "`default`, a row of taxels reads 1–2 N too much after the tare"),
    CampaignPart("parked", "parked", 1_000, "`default`, robots that stand askew by up to 5°"),
    CampaignPart("nudged", "nudged", 1_000, "`default`, targets that are moved while they charge"),
    CampaignPart("second", "second", 2_000, "`default`, pads and bars of the second contact physics"),
    CampaignPart(
        "second_1N", "second_1N", 1_000, "the same, by the pose model for sensors that read nothing below 1 N"
    ),
    CampaignPart("second_sensitive", "second_sensitive", 1_000, "the same, sheets that read forces from 0.25 N on"),
    CampaignPart("random_second", "random_second", 2_000, "`random`, pads and bars of the second contact physics"),
    CampaignPart("lean2", "lean2", 2_000, "`default`, faces yawed by up to 2°, a platform that yields"),
    CampaignPart("lean5", "lean5", 20_000, "the same, yawed and pitched by up to 5° each, springs of 3e4 and 1e5 N/m"),
    CampaignPart("lean5_stiff", "lean5_stiff", 1_000, "the same, springs of 3e5 N/m"),
    CampaignPart("edge_lean", "edge_lean", 20_000, "`edge`, faces yawed and pitched by up to 5° each"),
    CampaignPart("rigid", "rigid", 2_000, "`default`, a platform that does not yield, faces parallel to 0.1°"),
    CampaignPart("lean2_second", "lean2_second", 500, "`lean2`, pads and bars of the second contact physics"),
    CampaignPart("lean5_second", "lean5_second", 500, "`lean5`, pads and bars of the second contact physics"),
    CampaignPart("second_upright", "second_upright", 500, "`upright`, pads and bars of the second contact physics"),
    CampaignPart("lean2_exact", "lean2", 500, "`lean2`, every tick and frame computed", exact=True),
    CampaignPart("lean5_exact", "lean5", 500, "`lean5`, every tick and frame computed", exact=True),
    CampaignPart(
        "assumed_stiffness_exact", "assumed_stiffness", 500, "`assumed_stiffness`, every tick and frame", exact=True
    ),
    CampaignPart("rigid_exact", "rigid", 500, "`rigid`, every tick and frame computed", exact=True),
    CampaignPart("exact", "random", 1_000, "`random`, every tick and frame computed as the nodes do", exact=True),
    CampaignPart("real_arm_exact", "real_arm", 500, "`real_arm`, every tick and frame computed", exact=True),
    CampaignPart("worn_arm_exact", "worn_arm", 500, "`worn_arm`, every tick and frame computed", exact=True),
    CampaignPart("yielding_exact", "yielding", 500, "`yielding`, every tick and frame computed", exact=True),
    CampaignPart("strike", "default", 2_000, "`default`, every tick and frame computed", exact=True),
    CampaignPart("targets", "targets", 500, "25 kinds of charging ports in turn, charged to their end"),
    CampaignPart("target_pairs", "target_pairs", 1_000, "packs of six kinds, each with the profile of one of them"),
    CampaignPart("target_gaps", "target_gaps", 100, "ten minutes of charging through gaps of 1 ms to 5 s"),
    CampaignPart("hostile", "hostile", 20_000, "four scenes under one or two drawn faults"),
    CampaignPart("hostile_exact", "hostile", 1_000, "the same, every tick and frame computed", exact=True),
)


def make_plan(
    quick: bool = False, only: Sequence[str] = (), n: int | None = None, seed: int | None = None
) -> DockingPlan:
    """Return the plan of the committed report, or of a part.

    Args:
        quick: a hundredth of the dockings.
        only: names of the campaigns to run now; empty = all.
        n: dockings of each of these; None = as planned.
        seed: of all campaigns; None = `SEED`.

    Raises:
        ValueError: a name is unknown; the message lists the known ones.
    """
    names = [part.name for part in PARTS]
    for name in only:
        if name not in names:
            raise ValueError(f"there is no campaign '{name}' in this report; give one of {', '.join(names)}")
    chosen = tuple(name for name in names if not only or name in only)
    parts = []
    for part in PARTS:
        count = max(_FEWEST, math.ceil(QUICK * part.count)) if quick else part.count
        if n is not None and part.name in chosen:
            count = n
        parts.append(replace(part, count=count))
    return DockingPlan(tuple(parts), chosen, SEED if seed is None else seed, quick)


CHOSEN = (5, 19)
"""Seeds on which most of docking's rules and constants were chosen; comments beside the others name theirs."""


WORLDS = (
    *("default", "strike", "real_arm", "worn_arm", "yielding", "random", "second", "second_1N"),
    *("second_sensitive", "random_second", "assumed_stiffness", "assumed_stiffness_exact"),
    *("assumed_torque_constant", "assumed_gravity", "assumed_geometry", "high_row", "parked", "nudged"),
    *("rigid", "lean2", "lean5", "lean5_stiff", "second_upright", "lean2_second", "lean5_second"),
)
"""The campaigns beside which the headlines stand, if they were run."""
