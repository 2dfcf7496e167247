# SPDX-License-Identifier: Apache-2.0
"""Network reach of a process's nodes, its description, and the middleware's profile."""

import os
import sys
from pathlib import Path

import pytest

from deltacharger_core import environment

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
ENFORCED = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}


@pytest.fixture(autouse=True)
def nothing_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (RANGE, "ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY", "RMW_IMPLEMENTATION", *ENFORCED):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({RANGE: "SUBNET", "ROS_STATIC_PEERS": "10.0.0.7"}, "every computer of this network and to 10.0.0.7"),
        ({"ROS_LOCALHOST_ONLY": "1", "ROS_STATIC_PEERS": "10.0.0.7"}, "every program on this computer"),
        ({RANGE: "SYSTEM_DEFAULT", "ROS_STATIC_PEERS": "10.0.0.7"}, "programs that the middleware's profile admits"),
        (ENFORCED, "only nodes with a key of this keystore"),
        ({**ENFORCED, "ROS_SECURITY_STRATEGY": "Permissive"}, "every computer of this network"),
    ],
)
def test_the_text_states_who_can_command_the_nodes(
    monkeypatch: pytest.MonkeyPatch, settings: dict[str, str], text: str
) -> None:
    for name, value in settings.items():
        monkeypatch.setenv(name, value)
    assert environment.openness() == text


@pytest.mark.parametrize("kept", ["variable", "file", ""])
def test_fast_dds_settings_of_the_user_are_kept(kept: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They may be in a variable, or in a file of the working directory."""
    ours, theirs = "FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(ours, "")
    monkeypatch.setenv(theirs, "mine.xml" if kept == "variable" else "")
    if kept == "file":
        (tmp_path / "DEFAULT_FASTDDS_PROFILES.xml").write_text("<dds/>")
    environment.announce()
    assert Path(os.environ[ours]).name == ("" if kept else "fastdds.xml")


@pytest.mark.parametrize("chosen", ["", "rmw_fastrtps_cpp", "rmw_cyclonedds_cpp"])
def test_a_middleware_that_is_not_installed_is_named(
    chosen: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    index = tmp_path / "share/ament_index/resource_index/rmw_typesupport"
    index.mkdir(parents=True)
    for name in ("rmw_fastrtps_cpp", "rmw_implementation"):
        (index / name).touch()
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setenv("AMENT_PREFIX_PATH", "")
    monkeypatch.setenv("RMW_IMPLEMENTATION", chosen)
    text = "RMW_IMPLEMENTATION is 'rmw_cyclonedds_cpp', which is not installed; unset it, or choose rmw_fastrtps_cpp"
    assert environment.problem() == (text if chosen == "rmw_cyclonedds_cpp" else "")
