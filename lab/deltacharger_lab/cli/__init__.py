# SPDX-License-Identifier: Apache-2.0
"""The commands that the laboratory adds to `deltacharger`, by the entry point `deltacharger.commands`."""

from __future__ import annotations

COMMANDS = {
    "report": ("", "measure a part and write a page"),
    "report kinematics": (
        "deltacharger_lab.cli.report.kinematics",
        "error against run time of inverse and forward kinematics, extremes, and pictures of the workspace",
    ),
    "report tactile": (
        "deltacharger_lab.cli.report.tactile",
        "compare classifiers of misalignment on simulated data: accuracy, run time, splits, shifts, confidence",
    ),
    "report vision": (
        "deltacharger_lab.cli.report.vision",
        "the electrode detector on simulated images: detections, errors, run time, false alarms, both renderers",
    ),
    "report simulation": (
        "deltacharger_lab.cli.report.simulation",
        "error against run time, stability, energy and extremes of the simulated charger's mechanics",
    ),
    "report docking": (
        "deltacharger_lab.cli.report.docking",
        "thousands of simulated dockings: charged, refused, unsafe; repeat the command to resume",
    ),
    "report footprint": (
        "deltacharger_lab.cli.report.footprint",
        "resources that each scene needs: processes, start-up, memory, CPU at rest and docking, libraries (Linux)",
    ),
    "tactile generate": ("deltacharger_lab.cli.tactile.generate", "write a simulated data set"),
    "tactile train": ("deltacharger_lab.cli.tactile.train", "train a classifier"),
    "tactile evaluate": ("deltacharger_lab.cli.tactile.evaluate", "evaluate a trained classifier"),
    "tactile models": (
        "deltacharger_lab.cli.tactile.models",
        "list the packaged models that misalignment_node serves: accuracy, size and time",
    ),
    "campaign": (
        "deltacharger_lab.cli.campaign.campaign",
        "simulate many dockings without ROS, faster than real time; repeat the command to resume",
    ),
}
"""Command: its function with the module, and what it does; a group of commands has no function."""
