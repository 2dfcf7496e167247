# SPDX-License-Identifier: Apache-2.0
"""The parameters of docking_recorder_node."""

from __future__ import annotations

from dataclasses import dataclass

from deltacharger_core.parameters import Bounded, number, words


@dataclass(frozen=True)
class DockingRecorderNodeParameters(Bounded):
    """Folder of records, its limit, and the scene's name."""

    folder: str = words("~/deltacharger_records", "folder of the records")
    max_megabytes: int = number(500, 10, 1_000_000, "1e6 bytes", "total size of the records in {unit}")
    scene: str = words("", "written to each record")
