# SPDX-License-Identifier: Apache-2.0
"""The contract of the command: exit codes, one JSON object on stdout, everything else on stderr."""

from __future__ import annotations

import errno
import json
import math
import os
import shlex
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.cli import scene
from deltacharger_bringup.cli.main import build_parser

from ..chargers import Process
from .command import run

COMMANDS = (
    *("up", "dock", "undock", "scene", "simulate", "doctor", "tactile", "vision", "calibrate"),
    *("campaign", "report", "view", "replay", "fault"),
)


def one_object(text: str) -> dict[str, Any]:
    value = json.loads(text)
    assert isinstance(value, dict)
    return value


def test_help_lists_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "--help")
    assert code == 0
    for command in COMMANDS:
        assert f"    {command}" in out


@pytest.mark.parametrize(
    "words",
    [
        (),
        ("no-such-command",),
        ("scene",),
        ("dock", "--x-mm", "left"),
        ("dock", "--x-mm", "nan"),
        ("dock", "--critical-angle-deg", "-1"),
        ("dock", "--x-mm", "1", "--camera"),
        ("dock", "--roll-deg", "91"),
        ("dock", "--stop-after-s", "1e12"),
        ("dock", "--x-mm", "20000"),
        ("dock", "--namespace", "bad name"),
        ("dock", "--picture", ""),
        ("dock", "--picture", "run.docx"),
        ("dock", "--picture", "/no/such/folder/run.png"),
        ("simulate", "--directory", "never", "--record", "/no/such/folder/record.json"),
        ("simulate",),
        ("simulate", "--directory", "never", "--scene", "bench"),
    ],
)
def test_wrong_usage_ends_with_2_and_a_reason(capsys: pytest.CaptureFixture[str], words: tuple[str, ...]) -> None:
    code, out, err = run(capsys, *words)
    assert (code, out) == (2, "")
    assert err
    code, out, _ = run(capsys, *words, "--json")
    assert code == 2
    if words:
        assert one_object(out)["success"] is False


@pytest.mark.parametrize("command", ["up", "dock", "undock", "simulate"])
def test_a_refused_scene_ends_with_2_and_names_file_and_key(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, command: str
) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text("simulation: {sed: 1}", encoding="utf-8")
    more = ("--directory", str(tmp_path)) if command == "simulate" else ()
    code, out, err = run(capsys, command, "--scene", str(path), "--json", *more)
    assert code == 2
    assert one_object(out)["key"] == "simulation.sed"
    assert one_object(out)["file"] == str(path)
    assert "did you mean 'seed'" in err


@pytest.mark.parametrize("domain", ["abc", "-1", "233", "99999999999"])
def test_an_invalid_ros_domain_ends_with_2(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, domain: str
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    code, out, err = run(capsys, "undock", "--json")
    assert code == 2
    assert "0 to 232" in one_object(out)["error"]
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("problem", "exit_code"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), 1),
        (OSError(errno.EDQUOT, "Disk quota exceeded"), 1),
        (OSError(errno.EIO, "Input/output error"), 1),
        (BrokenPipeError(errno.EPIPE, "Broken pipe"), 1),
        (NotADirectoryError(errno.ENOTDIR, "Not a directory", "mount.yaml"), 2),
        (FileNotFoundError(errno.ENOENT, "No such file or directory", "mount.yaml"), 2),
        (PermissionError(errno.EACCES, "Permission denied", "mount.yaml"), 2),
        (IsADirectoryError(errno.EISDIR, "Is a directory", "mount.yaml"), 2),
    ],
)
def test_a_full_disk_is_a_failed_job_and_an_unusable_path_is_wrong_input(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, problem: OSError, exit_code: int
) -> None:
    def fail(options: object) -> int:
        raise problem

    monkeypatch.setattr(scene, "list_scenes", fail)
    code, out, err = run(capsys, "scene", "list", "--json")
    assert code == exit_code
    assert one_object(out)["error"] == err.strip()


@pytest.mark.parametrize(
    ("words", "refuse"),
    [
        (("report", "kinematics", "--quick", "--out", "{}/new"), "mkdir"),
        (("campaign", "-n", "1", "--out", "{}/new/a"), "mkdir"),
        (("calibrate", "kinematics", "--plan", "{}/plan.csv"), "TemporaryFile"),
    ],
    ids=lambda value: value if isinstance(value, str) else value[0],
)
def test_a_full_disk_is_not_wrong_input(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    words: tuple[str, ...],
    refuse: str,
) -> None:
    """A folder without write permission stays wrong input."""
    for number, exit_code in ((errno.ENOSPC, 1), (errno.EACCES, 2)):

        def fail(*arguments: object, number: int = number, **more: object) -> None:
            raise OSError(number, os.strerror(number), str(tmp_path))

        with monkeypatch.context() as patched:
            patched.setattr(Path if refuse == "mkdir" else tempfile, refuse, fail)
            code, _, err = run(capsys, *(word.format(tmp_path) for word in words))
        assert (code, err.count("\n")) == (exit_code, 1), err


def test_a_full_device_is_a_failed_job(deltacharger: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "plan.csv").symlink_to("/dev/full")
    words = [*deltacharger, "calibrate", "kinematics", "--plan", str(tmp_path / "plan.csv"), "--force"]
    ended = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stderr.count("\n")) == (1, 1), ended
    assert "No space left on device" in ended.stderr
    words[-2] = f"{tmp_path}/none/plan.csv"
    assert subprocess.run(words, capture_output=True, timeout=60, check=False).returncode == 2


def test_common_forms_of_numbers_and_namespaces_are_accepted() -> None:
    words = ["dock", "--z-mm", "-8e1", "--x-mm", "-.5", "--deadline-s", "0", "--namespace", "/robot/arm/"]
    options = build_parser().parse_args(words)
    assert (options.z_mm, options.x_mm, options.deadline_s) == (-80.0, -0.5, math.inf)
    assert options.namespace == "robot/arm"


def test_version_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "--version")
    assert (code, out.split()[0], len(out.splitlines())) == (0, "deltacharger", 1)


def test_a_closed_pipe_is_no_error(deltacharger: tuple[str, ...]) -> None:
    words = shlex.join((*deltacharger, "scene", "explain", "simulated", "--all"))
    ended = subprocess.run(
        ["bash", "-c", f"{words} | true; exit ${{PIPESTATUS[0]}}"], capture_output=True, text=True, check=False
    )
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.parametrize("times", [1, 2])
def test_ctrl_c_during_start_ends_with_130_and_one_object(
    start: Callable[..., Process], tmp_path: Path, times: int
) -> None:
    (tmp_path / "yaml.py").write_text("import time\nprint('reading', flush=True)\ntime.sleep(30)\n", encoding="utf-8")
    source = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); "
    source += "from deltacharger_bringup.cli.main import main; sys.exit(main())"
    process = start(sys.executable, "-c", source, "dock", "--json")
    process.wait_for_line("reading", process.out)
    for _ in range(times):
        process.process.send_signal(signal.SIGINT)
    assert process.end() == 130
    assert json.loads(process.out[-1]) == {"success": False, "error": "interrupted"}
    assert process.err == ["interrupted"]


def test_missing_coordinates_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = run(capsys, "dock", "--scene", "bench", "--x-mm", "3")
    assert code == 2
    assert "--y-mm, --z-mm missing" in err


def test_scene_list_check_and_explain_print_one_object_each(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "scene", "list", "--json")
    names = [scene["name"] for scene in one_object(out)["scenes"]]
    assert code == 0
    assert {"simulated", "mocks", "bench"} <= set(names)
    code, out, _ = run(capsys, "scene", "check", "--json")
    assert code == 0
    assert one_object(out)["ok"] is True
    code, out, _ = run(capsys, "scene", "explain", "simulated", "--json")
    assert code == 0
    assert any(key["key"] == "simulation.world.servo.stiffness" for key in one_object(out)["keys"])


def test_scene_check_warns_of_an_unvalidated_world(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "coarse.yaml"
    path.write_text("simulation: {world: {step: 0.1}}\n")
    code, out, err = run(capsys, "scene", "check", "--json", str(path))
    assert code == 0
    (report,) = json.loads(out)["scenes"]
    assert "the nearest verified point: step" in report["warnings"][0]
    assert "warning" in err


def test_scene_check_ends_with_2_if_one_scene_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text("goal: {x: 9}", encoding="utf-8")
    code, out, err = run(capsys, "scene", "check", "simulated", str(path), "--json")
    report = one_object(out)
    assert code == 2
    assert [scene["ok"] for scene in report["scenes"]] == [True, False]
    assert report["scenes"][1]["key"] == "goal.x"
    assert "goal.x" in err


def test_explain_shows_defaults_only_on_request(capsys: pytest.CaptureFixture[str]) -> None:
    _, short, _ = run(capsys, "scene", "explain", "simulated")
    _, everything, _ = run(capsys, "scene", "explain", "simulated", "--all")
    assert "simulation.world.target.x = 0.004 m" in short
    assert "simulation.world.servo.stiffness" not in short
    assert "simulation.world.servo.stiffness = 15 N·m/rad" in everything
