# SPDX-License-Identifier: Apache-2.0
"""The commands that the laboratory adds to `deltacharger`, by the entry point `deltacharger.commands`."""

COMMANDS = {
    "campaign": ("deltacharger_lab.cli.campaign.campaign", "simulate many dockings, or compare two such campaigns"),
    "report": ("deltacharger_lab.cli.report.report", "measure a part and write a page"),
}
"""Command: its function with the module, and what it does."""
