# SPDX-License-Identifier: Apache-2.0
"""Forces and heights use the charger's own geometry, gravity and servos, live and in a record."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from ..chargers import Spin, wait_until
from ..nodes import options
from .docking_tapes import docking, raw, write

pytest.importorskip("mcap", reason="records with deltacharger[record]")

from deltacharger.msg import ServoState
from rclpy.node import Node

from deltacharger_core.machine import JOINTS
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import DeltaGeometry, LimbAdjustment
from deltacharger_kinematics.geometry_file import save_geometry
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_records.node_parameters import docking_settings, known_settings, with_geometry
from deltacharger_records.replay.record import replay
from deltacharger_records.replay.recorder import Recorder
from deltacharger_ros import qos

pytestmark = pytest.mark.ros

LIMBS = (LimbAdjustment(arm=0.101), LimbAdjustment(angle_offset=0.05), LimbAdjustment())
CALIBRATED = DeltaGeometry(arm=0.103, limbs=LIMBS)
TILTED = {"gravity_x": 0.0, "gravity_y": -6.0, "gravity_z": 7.76, "torque_constant": 1.1}
PLACE, PUSH = (0.004, -0.003, 0.07), 12.0  # m, N


def pushing() -> ServoState:
    """Return servo_state of that charger while it pushes at that place."""
    delta = ScalarDelta(CALIBRATED)
    gravity = (TILTED["gravity_x"], TILTED["gravity_y"], TILTED["gravity_z"])
    held = delta.holding_torque(*PLACE, gravity)
    lever = delta.jacobian(*PLACE)[6:9]
    message = ServoState(name=list(JOINTS), valid=[True] * 3)
    message.position = list(delta.inverse(*PLACE))
    message.current = [(hold + PUSH * each) / TILTED["torque_constant"] for hold, each in zip(held, lever, strict=True)]
    return message


@pytest.fixture
def settings(tmp_path: Path) -> dict[str, Any]:
    """docking_node's parameters; the limbs' own adjustments are in its file only."""
    save_geometry(CALIBRATED, tmp_path / "arm.yaml")
    return {**TILTED, "geometry_file": str(tmp_path / "arm.yaml"), "arm": 0.103, "start_type_description_service": True}


def test_the_settings_are_docking_nodes_even_if_its_file_is_on_another_computer(settings: dict[str, Any]) -> None:
    parameters = DockingParameters(**TILTED)
    assert docking_settings(settings) == (parameters, CALIBRATED)
    kept = json.loads(json.dumps(with_geometry(settings)))
    Path(settings["geometry_file"]).unlink()
    assert known_settings(kept) == (parameters, CALIBRATED)
    with pytest.raises(OSError, match=r"arm\.yaml"):
        docking_settings(settings)
    assert known_settings(settings) == (parameters, DeltaGeometry(arm=0.103))
    assert known_settings({**settings, "geometry_file": "~nobody-here/arm.yaml"}) == known_settings(settings)
    assert known_settings({}) == (DockingParameters(), DeltaGeometry())


@pytest.mark.parametrize("own", [True, False])
def test_a_record_is_replayed_with_its_own_settings(tmp_path: Path, settings: dict[str, Any], own: bool) -> None:
    tape = [*docking(until=0.0), *(raw(2.6 + 0.01 * step, "servo_state", pushing()) for step in range(50))]
    path = write(tmp_path / "a.mcap", tape, parameters=with_geometry(settings) if own else {})
    motion = replay(path).run.motion.arrays()
    assert len(motion["z"]) == 50
    right = [motion["z"][-1] == pytest.approx(PLACE[2], abs=1e-9), motion["force"][-1] == pytest.approx(PUSH, abs=1e-6)]
    assert right == [own, own]


def test_dock_prints_the_force_of_the_running_charger(
    context: Any, namespace: str, spin: Spin, settings: dict[str, Any]
) -> None:
    charger = spin(Node("docking_node", **options(context, namespace)))
    for name, value in settings.items():
        if not charger.has_parameter(name):
            charger.declare_parameter(name, value)
    publisher = charger.create_publisher(ServoState, "servo_state", qos.LATEST)
    with Recorder(context, namespace) as recorder:

        def is_right() -> bool:
            publisher.publish(pushing())
            return recorder.force() == recorder.force()

        wait_until(is_right, "a force")
        assert recorder.force() == pytest.approx(PUSH, abs=1e-6)
        assert recorder.run.motion.arrays()["force"] == pytest.approx(PUSH, abs=1e-6), "from the first sample on"
