# SPDX-License-Identifier: Apache-2.0
"""`deltacharger tactile record --protocol`: both sets of the paper from a simulated charger in virtual time."""

from __future__ import annotations

import argparse

import numpy as np

from deltacharger_bringup.cli.files import file_to_write
from deltacharger_bringup.cli.output import DONE, WRONG_INPUT, CommandError, log_line, print_result
from deltacharger_core.files import atomic_write
from deltacharger_docking.codes import DockingError
from deltacharger_tactile.dataset import SUBSET_ANGLE

DEFAULT_PLACE = {"x_mm": 0.0, "y_mm": 0.0, "z_mm": 80.0}
"""Options for the position of the target's electrodes in charger_base."""
_OF_A_RUNNING_CHARGER = ("set", "angle_deg", "repeat", "offsets_mm", "compose", "namespace", "sensor", *DEFAULT_PLACE)


def record_protocol(options: argparse.Namespace) -> int:
    """Record both sets of the paper on one simulated rig."""
    for name in _OF_A_RUNNING_CHARGER:
        if getattr(options, name) not in (None, False, "", DEFAULT_PLACE.get(name)):
            flag = f"--{name.replace('_', '-')}"
            raise CommandError(f"{flag} is for a running charger; leave it out with --protocol", WRONG_INPUT)
    out = file_to_write("--out", options.out, ".npz")
    from deltacharger_lab.campaigns.recording import Protocol, record_paper

    shared = ("rig", "seed", "frames", "rows", "threshold", "dwell_s", "tare_every")
    recording = Protocol(**{name: getattr(options, name) for name in shared})
    try:
        data = record_paper(recording, log_line)
    except DockingError as error:
        raise CommandError(str(error), code=int(error.code)) from error
    with atomic_write(out) as path:
        data.save(path)
    left = data.poses()[data.subset == SUBSET_ANGLE, :2]
    rms = 1e3 * np.sqrt(np.mean(left**2, axis=0))
    text = (
        f"{out}: {len(data)} rows of {len(np.unique(data.attempt))} simulated dockings of rig {options.rig}; "
        f"start errors left by vision: {rms[0]:.1f} and {rms[1]:.1f} mm rms along x and y"
    )
    print_result(options, text, {"success": True, "out": str(out), "n": len(data), "left_rms_mm": rms.tolist()})
    return DONE
