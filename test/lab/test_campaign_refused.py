# SPDX-License-Identifier: Apache-2.0
"""What a campaign's scene refuses: by key, and before any docking."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from deltacharger_core.parameters import ParameterError, declared
from deltacharger_docking.parameters import DockingParameters
from deltacharger_lab.campaigns.assumed import Assumed
from deltacharger_lab.campaigns.scene import load_campaign_scene, packaged_campaigns, parse_campaign_scene
from deltacharger_scenes.scene import SceneError
from deltacharger_sim.parameters import ServoParameters


def x(spread: Any) -> dict[str, Any]:
    return {"target": {"x": spread}}


def second(**family: Any) -> dict[str, Any]:
    return {"pads": "second", "second": family}


def assumed(**values: Any) -> dict[str, Any]:
    return {"assumed": values}


TILTED = {"parked": {"heading": [-0.08, 0.08]}, "world": {"target": {"tilt_y": {"either_sign": [0.01, 0.03]}}}}
BASE = {"base_stiffness": [1e9, 2e9], "modulus": [1e5, 2e6], "thickness": [5e-4, 2e-3]}


@pytest.mark.parametrize(
    ("content", "key", "problem"),
    [
        ([], "(top)", "not a mapping"),
        ({"wrold": {}}, "wrold", "'world'"),
        ({"world": {"servo": {"stiffness": [1, 15]}}}, "world.servo.stiffness[0]", "2 to 40"),
        ({"world": {"target": {"x": 0.01}}}, "world.target.x", "target.x"),
        ({"docking": {"approach": "paper"}}, "docking.approach", "--approach"),
        (x([0.01, -0.01]), "target.x", "above"),
        (x({"log": [0.0, 0.01]}), "target.x.log", "no logarithm"),
        (x({"mean": 0.0, "stddev": -1.0}), "target.x.stddev", "outside 0"),
        (x(float("nan")), "target.x", "not finite"),
        ({"gravity": {"anywhere": True, "tilt": 0.1}}, "gravity.tilt", "gravity.anywhere"),
        ({"gravity": {"azimuth": 1.0}}, "gravity.azimuth", "no effect"),
        ({"shift": {"beyond_zero": 0.01, "roll": 0.1}}, "shift.roll", "shift.beyond_zero"),
        ({"based_on": "bad"}, "based_on", "packaged"),
        ({"tactile": {"contact": {"hole": 0.002}}}, "tactile.contact.hole", "electrode.hole"),
        ({"dockings": []}, "dockings", "not a list"),
        ({"dockings": [x([0.0, 0.01])]}, "dockings[0].target.x", "fixed"),
        ({**x(0.0), "dockings": [x(0.01)]}, "dockings[0].target.x", "keep one"),
        ({"docking": {"current_min": [0.40, 0.48]}}, "docking.current_min", "current_min + 2"),
        ({"world": {"circuit": {"voltage_min": 30.0, "voltage_max": 30.0}}}, "world.circuit.voltage_min", "below"),
        (assumed(geometry={"limb_0": {"arm": 0.01}}), "assumed.geometry.limb_0.arm", "-0.005 to 0.005"),
        (assumed(gravity_tilt=0.0, gravity_azimuth=1.0), "assumed.gravity_azimuth", "no effect"),
        ({**assumed(gravity_tilt=0.1), "gravity": {"tilt": 0.1, "known": False}}, "gravity.known", "contradicts"),
        ({"docking": {"servo_stiffness": 9.0}}, "docking.servo_stiffness", "assumed.servo_stiffness"),
        (TILTED, "parked.heading", "world.target.tilt_y"),
        ({"pads": {"choose": ["first", "other"]}}, "pads.choose[1]", "first, second"),
        ({"nudge": {"after": 3.0, "x": 0.0}}, "nudge.after", "no effect"),
        ({"pads": "second", "tactile": {"sensor": {"bits": 9}}}, "tactile.sensor.bits", "second"),
        ({"second": {"sheet": {"dead_band": 0.5}}}, "second.sheet.dead_band", "second"),
        (second(sheet={"dead_band": [0.0, 1.0]}), "second.sheet.dead_band_spread", "half"),
        (second(sheet={"edge_loss": [0.0, 0.5], "neighbour": [0.0, 0.2]}), "second.sheet.neighbour", "nothing"),
        (second(bars={"seat": [1e-6, 1e-3], "travel": [1e-4, 1e-2]}), "second.bars.seat", "below bars.travel"),
        (second(foundation=BASE), "second.foundation.base_stiffness", "increase"),
        ({"estimator": {"model": "1N", "paper": True}}, "estimator.model", "estimator.paper"),
    ],
)
def test_what_is_refused(content: Any, key: str, problem: str) -> None:
    with pytest.raises(ParameterError) as refusal:
        parse_campaign_scene(content, "bad")
    assert refusal.value.key == key
    assert problem in refusal.value.problem


@pytest.mark.parametrize(
    "content",
    [
        *(second(sheet={"dead_band": each}) for each in (0.0, {"choose": [0.0, 1.0]}, [0.8, 1.0])),
        {"nudge": {"x": {"mean": 0.0, "stddev": 0.001}, "after": 3.0}},  # moves though its mean is none
    ],
)
def test_what_is_allowed(content: dict[str, Any]) -> None:
    parse_campaign_scene(content, "x")


def test_every_stiffness_may_be_assumed_wrong_by_every_factor() -> None:
    kinds = (ServoParameters, "stiffness"), (Assumed, "servo_stiffness"), (DockingParameters, "servo_stiffness")
    true, factor, docking = ({key.name: key for key in declared(kind)}[name] for kind, name in kinds)
    assert docking.low <= true.low * factor.low < true.high * factor.high <= docking.high


@pytest.mark.rest
def test_packaged_scenes_load() -> None:
    assert {"default", "steep"} <= set(packaged_campaigns())
    assert all(load_campaign_scene(name).description for name in packaged_campaigns())


@pytest.mark.parametrize(("text", "key"), [("target: {x: 9}", "target.x"), ("based_on: rnadom", "based_on")])
def test_a_file_names_itself(tmp_path: Path, text: str, key: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text, "utf-8")
    with pytest.raises(SceneError) as refusal:
        load_campaign_scene(str(path))
    assert (refusal.value.file, refusal.value.key) == (str(path), key)
