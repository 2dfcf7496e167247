# SPDX-License-Identifier: Apache-2.0
"""The contract of the command: exit codes, one JSON object on stdout, everything else on stderr, nothing half done."""

import argparse
import contextlib
import errno
import json
import os
import sys
from pathlib import Path

import pytest

from deltacharger_bringup.cli import arguments, main, scene
from deltacharger_bringup.launch_arguments import CHARGER, VIEW, Options, given, in_launch, refuse_unknown_arguments
from deltacharger_bringup.scenes import executables
from deltacharger_core import streams

from .command import Capture, answer, refuses, run

FILES = {
    "bad.yaml": "simulation: {sed: 1}",
    "goal.yaml": "goal: {x: 9}",
    "k.yaml": "camera_matrix: 1",
    "text": "no recording",
    "text.csv": "no,table",
    "text.npz": "no archive",
    "text.mcap": "PNG and so on" * 100,
}
FIT, RECORD = "calibrate kinematics", "tactile record --out F.npz"
BOARD, PRINT = "calibrate camera --views .", "calibrate camera --print"
COLOR = "vision detect text.png"
# Command line, and a noun of what is said about it.
REFUSED = {
    "no-such-command": "no-such-command",
    "scene nowhere": "nowhere",
    "dock --scene bench --x-mm 3": "--y-mm, --z-mm",
    "dock --namespace 'bad name'": "--namespace",
    "dock --picture /proc/run.png": "/proc/run.png",
    "dock --scene bad.yaml": "seed",
    "simulate --directory never --scene bench": "bench",
    f"{FIT} text.csv --out /proc/arm.yaml": "/proc/arm.yaml",
    f"{FIT} text.csv": "text.csv",
    f"{PRINT} board.pdf": ".svg",
    f"{BOARD} --board-x-mm 20": "--board-y-mm, --board-z-mm",
    "calibrate tactile --data text.npz --out new.yaml": "data set",
    f"{RECORD} --set angle --angle-deg 6": "-5 to 5",
    f"{RECORD} --set reference --out text.npz": "npz file",
    COLOR: "--camera-info",
    f"{COLOR} --camera-info k.yaml": "k.yaml",
    "vision detect bare": "holds no recording",
    "replay text.mcap": "MCAP",
    "view --save /proc/view.rrd": "/proc/view.rrd",
    "view --recording text --stop-after-s 3 --save a.rrd": "running charger",
    **{f"view --web {address}": address for address in ("here", "127.0.0.1:65535")},
    "doctor --scene simulated --servo-port /dev/null": "simulated",
}
LIBRARIES = {
    "view": ("rerun", "mcap"),
    "vision": ("cv2", "mcap"),
    "replay": ("mcap",),
    RECORD[:14]: ("mcap",),
}


@pytest.fixture(scope="module")
def kit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kit")
    (folder / "bare").mkdir()
    for name, text in {**FILES, "text.png": "", "bare/a.color.png": ""}.items():
        (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize("line", REFUSED)
def test_wrong_input_ends_with_2_and_a_noun(
    capsys: Capture, kit: Path, monkeypatch: pytest.MonkeyPatch, line: str
) -> None:
    for library in (each for start, names in LIBRARIES.items() if line.startswith(start) for each in names):
        pytest.importorskip(library, reason=f"`{line}` needs {library}; `make optional` installs it")
    monkeypatch.chdir(kit)
    before = sorted(kit.rglob("*"))
    refuses(capsys, line, REFUSED[line])
    assert sorted(kit.rglob("*")) == before, "nothing is written"


def test_scene_lists_and_explains(capsys: Capture) -> None:
    assert {"simulated", "mocks", "bench"} <= {each["scene"] for each in answer(capsys, "scene")[1]["scenes"]}
    (explained,) = answer(capsys, "scene", "simulated")[1]["scenes"]
    assert explained["ok"]
    assert "simulation.world.servo.stiffness" in {each["key"] for each in explained["keys"]}


def test_help_lists_every_command_and_version_is_one_line(capsys: Capture) -> None:
    code, out, _ = run(capsys, "--help")
    assert (code, {each.split()[0] for each in main.COMMANDS} <= set(out.split())) == (0, True)
    code, out, _ = run(capsys, "--version")
    assert (code, out.split()[0], out.count("\n")) == (0, "deltacharger", 1)
    code, out, err = run(capsys)
    assert (code, out, "COMMAND" in err) == (2, "", True)


@pytest.mark.parametrize("line", ["campaign -n 1", "report docking"])
def test_a_command_of_the_laboratory_says_how_to_get_it_where_that_is_missing(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch, line: str
) -> None:
    monkeypatch.setattr("importlib.metadata.entry_points", lambda **group: ())
    refuses(capsys, line, "make lab")


@pytest.mark.parametrize("domain", ["abc", "233"])
def test_an_invalid_ros_domain_ends_with_2(capsys: Capture, monkeypatch: pytest.MonkeyPatch, domain: str) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    refuses(capsys, "undock", "232")


@pytest.mark.ros
def test_a_missing_middleware_ends_commands_and_nodes_with_2(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    """rcl would end the process with 102."""
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_nowhere_cpp")
    refuses(capsys, "undock", "rmw_nowhere_cpp")
    monkeypatch.setattr(executables.signals, "end_at_once", lambda code: None)
    assert executables.__getattr__("docking_node")() == 2
    assert "rmw_nowhere_cpp" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("kind", "exit_code"),
    [("ENOSPC", 1), ("EACCES", 2)],
)
def test_a_full_disk_is_a_failed_job_and_an_unusable_path_is_wrong_input(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch, kind: str, exit_code: int
) -> None:
    def fail(options: object) -> int:
        number = getattr(errno, kind)
        raise OSError(number, os.strerror(number), "mount.yaml")

    monkeypatch.setattr(scene, "scene", fail)
    refuses(capsys, "scene", "mount.yaml", exit_code)


@pytest.mark.parametrize("text", ["nan", "inf", "1e999", "9" * 5000, "", "1,5", "0x10", "2 3"])
def test_options_accept_only_finite_numbers(text: str) -> None:
    for kind in (arguments.between(-1.0, 1.0), arguments.integer(0, 9)):
        with pytest.raises(argparse.ArgumentTypeError):
            kind(text)


@pytest.mark.parametrize(("word", "shown"), [("\x1b]0;mine\x07", "\\u001b]0;mine\\u0007"), ("x" * 100_000, " … ")])
def test_no_word_controls_or_fills_the_terminal(capsys: Capture, word: str, shown: str) -> None:
    for words in (("replay", word), ("dock", "--json", f"--{word}")):
        code, out, err = run(capsys, *words)
        assert (code, shown in err, len(err) < 5000, "\x1b" in err) == (2, True, True, False)
        assert not out or json.loads(out)["success"] is False


def test_file_names_cannot_control_the_terminal(capsys: Capture, tmp_path: Path) -> None:
    pytest.importorskip("mcap", reason="records with deltacharger[record]")
    name = "\x1b]0;mine\x07\n\x9b.mcap"
    (tmp_path / name).write_bytes(b"no")
    code, out, _ = run(capsys, "replay", tmp_path)
    assert (code, streams.plain(out.strip())) == (0, out.strip())
    assert answer(capsys, "replay", tmp_path)[1]["records"][0]["file"] == name


ARGUMENTS = ["scene:=bench", "servo_prot:=/dev/ttyUSB1"]


@pytest.mark.parametrize(
    ("started", "file", "refused"),
    [
        (("deltacharger", "charger.launch.py"), "/opt/share/launch/charger.launch.py", True),
        (("charger.launch.py",), "{cwd}/charger.launch.py", True),
        (("my_robot", "charger.launch.py"), "/opt/share/launch/charger.launch.py", False),
    ],
    ids=["by package", "by path", "of another package"],
)
def test_an_unknown_argument_of_our_launch_file_is_refused_by_name(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, started: tuple[str, ...], file: str, refused: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", *started, *ARGUMENTS])
    path = file.format(cwd=tmp_path)
    with pytest.raises(ValueError, match=r"servo_prot.*'charger_servo_port'") if refused else contextlib.nullcontext():
        refuse_unknown_arguments(path, ARGUMENTS, CHARGER)
    refuse_unknown_arguments(path, ["scene:=bench", "launch-prefix:=gdb", "-d"], CHARGER)


@pytest.mark.parametrize("options", [CHARGER, VIEW])
def test_arguments_of_the_robot_that_includes_our_launch_file_change_nothing(
    monkeypatch: pytest.MonkeyPatch, options: Options
) -> None:
    usual = {name: default for name, (default, _) in options.items()}
    configurations = dict.fromkeys(options.keys() - {"scene"}, "the robot's")
    for name, default in usual.items():  # launch declares only what no including file has
        configurations.setdefault(in_launch(name), default)
    assert given(options, configurations) == usual
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "deltacharger", "our.launch.py"])
    for name in options.keys() - {"scene"}:
        with pytest.raises(ValueError, match=rf"^unknown argument '{name}'; did you mean 'charger_{name}'\?[^\n]*$"):
            refuse_unknown_arguments("/opt/our.launch.py", [f"{name}:=left"], options)
