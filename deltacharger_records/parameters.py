# SPDX-License-Identifier: Apache-2.0
"""The parameters of docking_recorder_node, recording_player_node and passive_joints_node."""

from __future__ import annotations

from dataclasses import dataclass

from deltacharger_core.parameters import Bounded, flag, number, words


@dataclass(frozen=True)
class DockingRecorderNodeParameters(Bounded):
    """Folder, limits and content of records."""

    folder: str = words("~/deltacharger_records", "folder of the records")
    max_files: int = number(200, 1, 100_000, "", "records in the folder; the oldest are removed")
    max_megabytes: int = number(500, 10, 1_000_000, "1e6 bytes", "total size of the records in {unit}")
    before: float = number(2.0, 0.0, 30.0, "s", "{unit} kept before the goal and before each event")
    charging_rate: float = number(1.0, 0.01, 100.0, "", "messages of each topic per second kept while charging")
    scene: str = words("", "written to each record")


@dataclass(frozen=True)
class RecordingPlayerNodeParameters(Bounded):
    """What is played, and how fast."""

    file: str = words("", "record of a docking, or MCAP file of `ros2 bag record`, to play")
    charger: str = words("", "namespace to play if the recording has several; '' = the only one")
    delay: float = number(
        3.5,
        0.0,
        600.0,
        "s",
        "{unit} before playing: time to find a running charger, which may take 3 s, and for readers to connect",
    )
    rate: float = number(1.0, 0.01, 100.0, "", "playing speed relative to the recording")
    loop: bool = flag(False, "restart at the end")


@dataclass(frozen=True)
class PassiveJointsNodeParameters(Bounded):
    """How often joint_states is published."""

    rate: float = number(30.0, 0.1, 200.0, "Hz", "highest rate of joint_states")
