# SPDX-License-Identifier: Apache-2.0
"""Every command in every kind of shell: a line with the problem and the right exit code, never a traceback."""

from __future__ import annotations

import argparse
import ast
import contextlib
import io
import itertools
import json
import math
import os
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from deltacharger_bringup.cli.main import COMMANDS, build_parser, main
from deltacharger_core import streams
from deltacharger_scenes import executables

from .command import run

ROOT = Path(__file__).resolve().parents[2]
CLI = (sys.executable, "-m", "deltacharger_bringup.cli")
LONG = "x" * 100_000

# Command lines, and their exit codes in a normal shell.
COMMAND_LINES: dict[str, tuple[tuple[str, ...], int]] = {
    "list": ((*CLI, "scene", "list"), 0),
    "json": ((*CLI, "scene", "check", "--json"), 0),
    "help": ((*CLI, "--help"), 0),
    "version": ((*CLI, "--version"), 0),
    "explain": ((*CLI, "scene", "explain", "simulated", "--all"), 0),
    "faults": ((*CLI, "fault", "--list"), 0),
    "wrong": ((*CLI, "dock", "--x-mm", "left", "--json"), 2),
    "missing": ((*CLI, "vision", "detect", "nothing.png"), 2),
    "folder": ((*CLI, "calibrate", "kinematics", "--plan", "/proc/self/plan.csv"), 2),
    "below a file": ((*CLI, "calibrate", "kinematics", "--plan", "/etc/passwd/plan.csv"), 2),
    "node": ((sys.executable, "-m", "deltacharger_driver.servos.servo_node"), 2),
}
FULL, CLOSED, BOTH = "{} >/dev/full", "{} >&-", "{} >&- 2>&-"
PLAIN_C = "LC_ALL=C PYTHONUTF8=0 PYTHONCOERCECLOCALE=0"
SHELLS = {
    "full": FULL,
    "closed": CLOSED,
    "closed errors": "{} 2>&-",
    "full errors": "{} 2>/dev/full",
    "both closed": BOTH,
    "all closed": "{} <&- >&- 2>&-",
    "both full": "{} >/dev/full 2>/dev/full",
    "a reader that leaves": "{} | head -1; exit ${{PIPESTATUS[0]}}",
    "ASCII": f"{PLAIN_C} PYTHONIOENCODING=ascii {{}}",
    "C": f"{PLAIN_C} {{}}",
    "Latin-1": "PYTHONIOENCODING=latin-1 {}",
    "no home": "env -u HOME -u ROS_LOG_DIR {}",
    "a home that cannot be": "env -u ROS_LOG_DIR HOME=/proc/nowhere {}",
    "no folder for what is temporary": "TMPDIR=/nowhere {}",
    "optimised": "{} ",  # by option -O
    "removed folder": "mkdir gone && cd gone && rmdir ../gone && {}",
}
FULL_OUT = ("full", "both full", "closed", "both closed", "all closed")
NO_ERRORS = ("closed errors", "full errors", "both closed", "all closed", "both full")
DIAGONAL = [
    *(("list", shell) for shell in ("full", "closed", "both closed", "all closed", "a reader that leaves")),
    *(("json", shell) for shell in ("ASCII", "Latin-1")),
    *(("help", shell) for shell in ("full", "closed errors")),
    *(("explain", shell) for shell in ("C", "a reader that leaves")),
    *(("wrong", shell) for shell in ("closed errors", "both full")),
    *(("faults", shell) for shell in ("optimised", "removed folder")),
    ("version", "full errors"),
    ("missing", "removed folder"),
    ("folder", "no folder for what is temporary"),
    ("below a file", "no home"),
    ("node", "a home that cannot be"),
]


@pytest.mark.parametrize(
    ("command", "shell"),
    [
        pytest.param(*each, marks=() if each in DIAGONAL else pytest.mark.rest)
        for each in itertools.product(COMMAND_LINES, SHELLS)
    ],
)
def test_a_hostile_shell_costs_a_command_only_its_output(command: str, shell: str, tmp_path: Path) -> None:
    words, code = COMMAND_LINES[command]
    if shell == "optimised":
        words = (words[0], "-O", *words[1:])
    line = SHELLS[shell].format(shlex.join(words))
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    ended = subprocess.run(
        ["bash", "-c", line], cwd=tmp_path, env=environment, capture_output=True, check=False, timeout=60
    )
    text = ended.stderr.decode()
    if shell in FULL_OUT and command not in ("missing", "folder", "below a file", "node"):
        code = code or 1
    assert ended.returncode == code, text
    assert "Traceback" not in text
    assert "Exception ignored" not in text
    if shell in NO_ERRORS:
        assert text == ""
    elif code:
        assert text.strip(), "no line names the problem"
    if shell in FULL_OUT:
        assert ended.stdout == b""
    elif command in ("json", "wrong") and shell != "a reader that leaves":
        assert isinstance(json.loads(ended.stdout.decode()), dict)
    assert list(tmp_path.iterdir()) == []


def _executables() -> list[str]:
    return sorted(executables.MODULES.values())


@pytest.mark.rest
@pytest.mark.parametrize("shell", ["full", "all closed", "full errors", "C", "optimised", "a home that cannot be"])
@pytest.mark.parametrize("module", _executables())
def test_a_node_that_cannot_start_reports_it_in_every_shell(module: str, shell: str, tmp_path: Path) -> None:
    words = [sys.executable, *(["-O"] if shell == "optimised" else []), "-m", module]
    line = SHELLS[shell].format(shlex.join([*words, "--ros-args", "-p", "no_such_parameter:=1"]))
    ended = subprocess.run(
        ["bash", "-c", line],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        check=False,
        timeout=60,
    )
    text = ended.stderr.decode()
    assert (ended.returncode, ended.stdout) == (2, b""), text
    assert "Traceback" not in text
    assert "Exception ignored" not in text
    assert bool(text.strip()) is (shell not in NO_ERRORS)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words",
    [
        *(("calibrate", "kinematics", "--plan", f"{folder}/plan.csv") for folder in ("/proc", "/sys", "/etc/passwd")),
        ("tactile", "generate", "--out", "/proc/data.npz"),
        ("dock", "--picture", "/proc/run.png"),
        ("view", "--save", "/proc/view.rrd"),
        ("simulate", "--directory", "never", "--record", "/proc/record.json"),
        *(("report", "kinematics", "--quick", "--out", out) for out in ("/proc/report", "/sys", "/etc/passwd/report")),
        ("campaign", "--out", "/proc/campaign"),
    ],
    ids=" ".join,
)
def test_an_unwritable_path_is_refused_before_any_work(
    capsys: pytest.CaptureFixture[str], words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if words[0] == "view":
        pytest.importorskip("rerun", reason="deltacharger[view]")
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, *words)
    assert (code, out) == (2, "")
    assert words[-1] in err
    assert list(tmp_path.iterdir()) == []


def _commands(parser: argparse.ArgumentParser, name: str = "") -> Iterator[tuple[str, argparse.ArgumentParser]]:
    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()):
        parser.parse_args(["--help"])  # options are added when a command is parsed
    groups = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    yield name, parser
    for word, below in (each for group in groups for each in group.choices.items()):
        yield from _commands(below, f"{name} {word}".strip())


def test_no_option_accepts_an_infinite_number() -> None:
    found = dict(_commands(build_parser()))
    assert set(COMMANDS) <= set(found)
    tried = 0
    for name, parser in found.items():
        for action in (each for each in parser._actions if callable(each.type)):
            for text in ("nan", "inf", "-inf", "1e999", "-1e999", "9" * 5000, "", "1,5", "0x10", "\udcff", "2 3"):
                try:
                    value = action.type(text)  # type: ignore[operator]
                except (argparse.ArgumentTypeError, ValueError):
                    continue
                finally:
                    tried += 1
                assert not isinstance(value, float) or math.isfinite(value), (name, action.dest, text)
    assert tried > 500


@pytest.mark.parametrize(
    ("word", "shown"),
    [
        ("a\nb", "a\\u000ab"),
        ("\x1b]0;mine\x07", "\\u001b]0;mine\\u0007"),
        ("\x9b31m", "\\u009b31m"),
        ("a\u202eb", "a\\u202eb"),
        ("nul\0", "nul\\u0000"),
        (LONG, "characters, more than"),
    ],
    ids=["newline", "escape", "C1", "right to left", "nul", "long"],
)
@pytest.mark.parametrize("command", COMMANDS)
def test_a_word_with_control_characters_is_refused(
    capsys: pytest.CaptureFixture[str], command: str, word: str, shown: str
) -> None:
    for words in ((*command.split(), word), (*command.split(), "--json", f"--{word}")):
        code, out, err = run(capsys, *words)
        assert code == 2
        assert shown in err
        assert len(err) < 5000
        assert streams.plain(err.strip()) == err.strip(), "one line without control characters"
        assert not out or json.loads(out)["success"] is False


@pytest.mark.parametrize("word", ["\udcff.yaml", "caf\udce9", "", "-"], ids=["bytes", "Latin-1", "empty", "dash"])
@pytest.mark.parametrize("command", ["replay", "vision detect", "scene check", "scene explain", "tactile evaluate"])
def test_a_name_that_is_empty_or_not_utf8_is_reported(
    capsys: pytest.CaptureFixture[str], command: str, word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = run(capsys, *command.split(), word)
    assert code in ((0, 2) if command == "replay" and not word else (1, 2))
    assert err


def test_file_names_cannot_control_the_terminal(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("mcap", reason="records with deltacharger[record]")
    (tmp_path / "\x1b]0;mine\x07\n\x9b.mcap").write_bytes(b"no")
    code, out, _ = run(capsys, "replay", tmp_path)
    assert code == 0
    assert streams.plain(out.strip()) == out.strip()
    code, out, _ = run(capsys, "replay", tmp_path, "--json")
    assert json.loads(out)["records"][0]["file"] == "\x1b]0;mine\x07\n\x9b.mcap"


class Stream(io.TextIOWrapper):
    """A standard output with another encoding, without a file descriptor."""

    def __init__(self, encoding: str) -> None:
        super().__init__(io.BytesIO(), encoding=encoding, errors="backslashreplace", write_through=True)


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252", "utf-8", "utf-16"])
def test_json_is_valid_in_every_encoding(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, encoding: str) -> None:
    out = Stream(encoding)
    monkeypatch.setattr(sys, "stdout", out)
    folder = tmp_path / "ü–\udcff\U0001f50c"
    folder.mkdir()
    assert main(["replay", str(folder), "--json"]) == 0
    assert json.loads(out.buffer.getvalue().decode(encoding))["folder"] == str(folder)  # type: ignore[attr-defined]


@pytest.mark.parametrize("words", [("scene", "list"), ("--help",), ("scene", "check", "--json")])
def test_a_lost_output_is_a_failed_job(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    with open("/dev/full", "w", encoding="utf-8") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert main(words) == 1
        monkeypatch.undo()
    assert capsys.readouterr().err == "cannot write to standard output: No space left on device\n"
    assert streams.settle() == ""


def test_product_code_does_not_depend_on_assert() -> None:
    """Asserts only help mypy; they call nothing, and no input can violate them."""
    wrong = []
    for path in ROOT.glob("deltacharger_*/**/*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Assert):
                calls = [each for each in ast.walk(node.test) if isinstance(each, ast.Call)]
                if any(not (isinstance(call.func, ast.Name) and call.func.id == "isinstance") for call in calls):
                    wrong.append(f"{path}:{node.lineno}")
    assert wrong == []


@pytest.mark.parametrize("name", ["de_DE.UTF-8", "fr_FR.UTF-8", "C"])
def test_numbers_have_a_decimal_point_in_every_locale(capsys: pytest.CaptureFixture[str], name: str) -> None:
    import locale

    before = locale.setlocale(locale.LC_ALL)
    try:
        locale.setlocale(locale.LC_ALL, name)
    except locale.Error:
        pytest.skip(f"locale {name} is not installed")
    try:
        code, out, _ = run(capsys, "scene", "explain", "simulated", "--json", "--all")
    finally:
        locale.setlocale(locale.LC_ALL, before)
    assert code == 0
    assert json.loads(out)
    assert "0.5" in out
