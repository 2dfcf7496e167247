# SPDX-License-Identifier: Apache-2.0
"""Findings of the doctor for this computer: settings, ROS, camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.doctor.camera import examine_camera
from deltacharger_bringup.doctor.environment import RosProbe, examine_settings
from deltacharger_bringup.doctor.findings import Finding, checked, ok

from ...chargers import new_namespace
from .found import one, only


def test_a_failed_check_is_a_finding_and_keeps_earlier_findings() -> None:
    def broken() -> Iterator[Finding]:
        yield ok("first", "fine")
        raise ZeroDivisionError("nothing to divide")

    def lacking() -> Iterator[Finding]:
        yield ok("first", "fine")
        import a_module_that_nobody_has  # noqa: F401

    found = checked("second", broken)
    assert [finding.level for finding in found] == ["ok", "wrong"]
    assert "nothing to divide" in found[1].message
    found = checked("second", lacking)
    assert [finding.level for finding in found] == ["ok", "wrong"]
    assert "a_module_that_nobody_has" in found[1].remedy


@pytest.mark.parametrize(
    ("name", "value", "part"),
    [
        ("ROS_DOMAIN_ID", "500", "ros domain"),
        ("ROS_DOMAIN_ID", "home", "ros domain"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF", "ros discovery"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "HERE", "ros discovery"),
        ("AMENT_PREFIX_PATH", "/usr", "ros prefix"),
        ("AMENT_PREFIX_PATH", "", "ros prefix"),
    ],
)
def test_settings_that_disable_ros_are_wrong(monkeypatch: pytest.MonkeyPatch, name: str, value: str, part: str) -> None:
    assert only(examine_settings(), "wrong") == []
    monkeypatch.setenv(name, value)
    assert one(examine_settings(), "wrong", part).remedy


def test_a_missing_camera_is_reported_but_never_wrong(tmp_path: Path) -> None:
    absent = list(examine_camera(None, tmp_path))
    assert not only(absent, "wrong")
    assert any("no OAK camera is on USB" in finding.message for finding in absent)
    (tmp_path / "2-1").mkdir()
    (tmp_path / "2-1" / "idVendor").write_text("03e7\n")
    present = list(examine_camera(2, tmp_path))
    assert any("an OAK camera is on USB" in finding.message for finding in only(present, "ok"))
    assert any("2 publishers" in finding.message for finding in only(present, "ok"))


def test_a_running_charger_is_named(context: Any) -> None:
    from deltacharger.msg import DockingState
    from rclpy.node import Node

    node = Node("docking_node", context=context, namespace=new_namespace())
    node.create_publisher(DockingState, "docking_state", 1)
    probe = RosProbe()
    try:
        found = list(probe.examine())
    finally:
        probe.close()
        namespace = node.get_namespace()
        node.destroy_node()
    assert not only(found, "wrong")
    assert namespace in one(found, "hint", "charger").message
    assert {finding.part for finding in found} >= {"rclpy", "interfaces", "numpy and ROS", "ros middleware"}


WRONG_SETTINGS = {"RMW_IMPLEMENTATION": "rmw_that_nobody_has", "AMENT_PREFIX_PATH": "/usr", "ROS_DOMAIN_ID": "500"}


@pytest.fixture(scope="module")
def found_with() -> Iterator[Callable[[str], list[Finding]]]:
    """Findings with one wrong setting; the checks of ROS, which take seconds, run in parallel."""
    settings: dict[str, list[Finding]] = {}
    probes: dict[str, RosProbe] = {}
    for name, value in WRONG_SETTINGS.items():
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv(name, value)
            settings[name] = list(examine_settings())
            probes[name] = RosProbe()
    yield lambda name: [*settings[name], *probes[name].examine()]
    for probe in probes.values():
        probe.close()


@pytest.mark.parametrize(
    ("name", "part", "remedy"),
    [
        ("RMW_IMPLEMENTATION", "ros middleware", "unset RMW_IMPLEMENTATION"),
        ("AMENT_PREFIX_PATH", "ros prefix", "setup.bash"),
        ("ROS_DOMAIN_ID", "ros domain", "0 to 232"),
    ],
)
def test_a_wrong_ros_setting_gives_one_wrong_finding(
    found_with: Callable[[str], list[Finding]], name: str, part: str, remedy: str
) -> None:
    wrong = only(found_with(name), "wrong")
    assert [finding.part for finding in wrong] == [part]
    assert remedy in wrong[0].remedy
