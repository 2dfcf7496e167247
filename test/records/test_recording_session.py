# SPDX-License-Identifier: Apache-2.0
"""Recording sessions in virtual time: docking's real steps in the simulated world, without ROS; and their journal."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from deltacharger_bringup.records import session
from deltacharger_core.machine import DOCKING_JITTER
from deltacharger_docking import codes, observation, parameters
from deltacharger_sim.parameters import TargetParameters, WorldParameters
from deltacharger_sim.virtual.virtual_charger import VirtualCharger
from deltacharger_sim.world import Snapshot
from deltacharger_tactile.dataset import Dataset

from ..quick import STEPS

FRAMES = 12
LIMIT = 300.0  # simulated s


def part_of(kind: str, **changes: object) -> session.Part:
    angle = 2.0 if kind in session.TILTED else 0.0
    part = session.Part(kind, angle, 3, seed=1, x_mm=0.0, y_mm=0.0, z_mm=80.0)
    return dataclasses.replace(part, **changes)  # type: ignore[arg-type]


class Ear:
    """A keeper that takes the world's frames, and knows the true pose."""

    def __init__(self, charger: VirtualCharger) -> None:
        self.kept_rows: list[tuple[int, session.Rested, np.ndarray, Snapshot]] = []
        self._charger = charger
        self._frames: list[np.ndarray] = []
        self._number = -1
        self._truth: Snapshot | None = None

    def begin_docking(self, number: int) -> None:
        self._number = number

    def start_frames(self) -> None:
        self._frames = []

    def has_frames(self) -> bool:
        self._frames.append(self._charger._frame.copy())
        self._truth = self._charger.world.snapshot()
        assert self._truth.misalignment is not None
        return len(self._frames) == FRAMES

    def keep(self, touch: session.Rested) -> None:
        assert self._charger.world.snapshot().misalignment is None, "kept before the arm had released the target"
        assert self._truth is not None
        self.kept_rows.append((self._number, touch, np.mean(self._frames, axis=0), self._truth))

    def kept(self) -> bool:
        return True


class Bench:
    """A virtual charger that runs sessions."""

    def __init__(self, roll: float = 0.0) -> None:
        world = WorldParameters(target=TargetParameters(roll=roll))
        self.charger = VirtualCharger(world, parameters.DockingParameters(**STEPS))
        self.machine = self.charger.machine
        self.ear = Ear(self.charger)
        self.asked: list[observation.Service] = []
        self._accept = self.charger._accept
        self.charger._accept = self._note  # type: ignore[method-assign]

    def _note(self, request: observation.Request) -> None:
        self.asked.append(request.service)
        self._accept(request)

    def start(self, poses: list[session.CommandedPose]) -> None:
        commands = [(-pose.horizontal, -pose.vertical, 0.080) for pose in poses]
        session.check_places(self.machine, commands)
        self.charger.start(session.TouchSession(commands, 0.5, FRAMES / 120.0, self.ear).run)

    def run(self, poses: list[session.CommandedPose]) -> codes.Code:
        self.start(poses)
        outcome = self.charger.finish(LIMIT)
        self.assert_safe()
        return outcome.code

    def assert_safe(self) -> None:
        assert set(self.asked) <= {
            observation.Service.TARE,
            observation.Service.TORQUE_ON,
            observation.Service.TORQUE_OFF,
        }
        assert self.charger.world.record.energised == 0.0
        assert not self.charger.observe().torque_enabled
        assert not self.machine.busy


@pytest.mark.parametrize("degrees", [0.0, -3.0])
def test_the_target_is_measured_at_the_commanded_pose(degrees: float) -> None:
    roll = math.radians(degrees)
    bench, corners = Bench(roll), [session.CommandedPose(-0.006, 0.004, roll)]
    assert bench.run(corners) is codes.Code.NONE
    assert [number for number, *_ in bench.ear.kept_rows] == [0]
    for number, touch, frames, truth in bench.ear.kept_rows:
        assert truth.misalignment is not None
        x, y, angle = truth.misalignment
        pose = corners[number]
        # A docking's jitter, four standard deviations, and the offset held back by friction.
        assert abs(x - pose.horizontal) < 4 * DOCKING_JITTER + 0.001
        assert abs(y - pose.vertical) < 4 * DOCKING_JITTER + 0.001
        assert abs(angle - roll) < math.radians(0.6)
        assert math.dist(touch.position[:2], truth.position[:2]) < 2e-4
        assert bench.charger.parameters.current_min <= touch.current <= bench.charger.parameters.current_max
        assert np.nanmax(frames) > 1.0
    assert math.dist(bench.charger.world.snapshot().position, (0.0, 0.0, 0.0)) < 0.003


@pytest.mark.parametrize("state", [codes.State.APPROACH, codes.State.MEASURE, codes.State.RETRACT])
def test_a_cancel_in_any_step_returns_the_arm_home_and_switches_the_torque_off(state: codes.State) -> None:
    bench = Bench()
    bench.start([session.CommandedPose(0.0, 0.0, 0.0)] * 2)
    bench.charger.until(lambda: bench.machine.status.state is state, LIMIT)
    bench.machine.cancel()
    assert bench.charger.finish(LIMIT).code is codes.Code.CANCELED
    assert math.dist(bench.charger.world.snapshot().position, (0.0, 0.0, 0.0)) < 0.003
    bench.assert_safe()


def test_targets_out_of_reach_wired_electrodes_and_second_sessions_are_refused_without_motion() -> None:
    bench = Bench()
    with pytest.raises(codes.Unreachable, match="reach"):
        bench.start([session.CommandedPose(0.0, 0.0, 0.0), session.CommandedPose(0.2, 0.0, 0.0)])
    assert not bench.machine.busy
    bench.start([session.CommandedPose(0.0, 0.0, 0.0)])
    with pytest.raises(codes.Busy):
        bench.start([session.CommandedPose(0.0, 0.0, 0.0)])
    with pytest.raises(codes.Rejected, match="electrodes"):
        session.check_places(
            VirtualCharger(parameters=parameters.DockingParameters(power="none")).machine, [(0.0, 0.0, 0.080)]
        )


def test_the_sets_are_the_papers() -> None:
    position = part_of("position", repeat=20).poses()
    assert len(position) == 500
    for begin in range(0, 500, 25):
        offsets = {(round(1e3 * pose.horizontal), round(1e3 * pose.vertical)) for pose in position[begin : begin + 25]}
        assert offsets == {(x, y) for x in session.OFFSETS_MM for y in session.OFFSETS_MM}
    angle = part_of("angle", repeat=100).poses()
    assert len(angle) == 100
    assert all(pose == session.CommandedPose(0.0, 0.0, 0.0) for pose in part_of("reference").poses())


PART = session.Part("reference", 0.0, 10, 0, 0.0, 0.0, 80.0)
SETTINGS = session.Settings(rig=1, frames=1, simulated=False)


def docking(number: int) -> session.Docking:
    pads = np.full((2, 10, 10), 0.2, dtype=np.float32)
    pads[0, 3, 4], pads[1, 0, 0] = 2.0, np.nan
    return session.Docking(number, 0, session.CommandedPose(0.0, 0.0, 0.0), 1e-4, -2e-4, 0.45, pads)


def test_a_data_set_grows_docking_by_docking_and_a_later_call_continues(tmp_path: Path) -> None:
    out = tmp_path / "F.npz"
    for number in range(3):
        journal = session.Journal(out)
        journal.check(PART, dataclasses.replace(SETTINGS, simulated=None))
        assert (journal.dockings, journal.done(PART), journal.next_session) == (number, set(range(number)), number > 0)
        journal.add_docking(docking(number), PART, SETTINGS)
    assert journal.parts() == {"reference": (3, 10)}
    found = Dataset.load(out)
    assert list(found.attempt) == [0, 1, 2]
    assert found.left[0, 3, 4] == 2.0
    assert found.left.sum() == 6.0  # readings below the threshold are 0
    assert found.dead[:, 1, 0, 0].all()
    assert found.dead.sum() == 3
    assert found.poses()[0] == pytest.approx((1e-4, -2e-4, 0.0))
    assert found.meta["simulated"] is False
    assert [each.name for each in tmp_path.iterdir()] == ["F.npz"]


def test_a_file_accepts_no_other_settings_and_no_foreign_file_is_continued(tmp_path: Path) -> None:
    out = tmp_path / "F.npz"
    session.Journal(out).add_docking(docking(0), PART, SETTINGS)
    journal = session.Journal(out)
    with pytest.raises(session.Mismatch, match=r"that is real \(not simulated\)"):
        journal.check(PART, dataclasses.replace(SETTINGS, simulated=True))
    with pytest.raises(session.Mismatch, match=r"--z-mm 80\.0 \(not 75\.0\)"):
        journal.check(dataclasses.replace(PART, z_mm=75.0), SETTINGS)
    journal.check(dataclasses.replace(PART, set="angle", z_mm=75.0), SETTINGS)
    data = Dataset.load(out)
    dataclasses.replace(data, meta={**data.meta, "parts": [{"name": "reference"}]}).save(out)
    with pytest.raises(session.Mismatch, match="another --out"):
        session.Journal(out)
