# SPDX-License-Identifier: Apache-2.0
"""Checks the documentation: links have targets, commands parse, names exist."""

from __future__ import annotations

import ast
import os
import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from deltacharger_bringup.cli import main as cli
from deltacharger_docking import codes

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "examples/*.md")
    for path in ROOT.glob(pattern)
    if not path.name.startswith(".")
)
PACKAGES = sorted(path.parent for path in ROOT.glob("deltacharger_*/__init__.py"))
TOUR = ROOT / "docs" / "tour.md"

_LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)(?:\s+\"[^\"]*\")?\)")
_FENCE = re.compile(r"^( *)(```+|~~~+)[^\n]*\n(.*?)^\1\2\s*$", re.MULTILINE | re.DOTALL)
_HEADING = re.compile(r"^#+\s+(.*)$", re.MULTILINE)
_QUOTED = re.compile(r"`([^`\n]+)`")
_DOTTED = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)+")
_COMMAND = re.compile(r"^(?:\$ )?(?:[A-Z_]+=\S+ )*(?:\S*/)?deltacharger (?P<words>.*)$")
_ENDS = ("&", "|", ">", "2>", ">>", "&&", "||", ";")
_FILE_SUFFIXES = (".py", ".yaml", ".md", ".cfg", ".toml", ".msg", ".srv", ".action", ".csv", ".json")


def ids(path: Path) -> str:
    return str(path.relative_to(ROOT))


def prose(text: str) -> str:
    return _FENCE.sub("", text)


def slug(heading: str) -> str:
    """Return GitHub's anchor of a heading."""
    words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "").strip().lower()
    return re.sub(r"[^\w\- ]", "", words).replace(" ", "-")


@cache
def anchors(path: Path) -> frozenset[str]:
    seen: dict[str, int] = {}
    found = set()
    for heading in _HEADING.findall(prose(path.read_text(encoding="utf-8"))):
        name = slug(heading)
        number = seen.get(name, 0)
        seen[name] = number + 1
        found.add(name if number == 0 else f"{name}-{number}")
    return frozenset(found)


@pytest.mark.parametrize("page", PAGES, ids=ids)
def test_every_link_has_a_target(page: Path) -> None:
    for target in _LINK.findall(prose(page.read_text(encoding="utf-8"))):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        path = (page.parent / name).resolve() if name else page
        assert path.exists(), f"{target}: there is no {path}"
        if anchor and path.suffix == ".md":
            assert anchor in anchors(path), f"{target}: {path.name} has no such heading"


def commands(page: Path) -> Iterator[str]:
    """Yield the arguments of `deltacharger` commands in the page's code blocks; a backslash joins lines."""
    text = page.read_text(encoding="utf-8")
    blocks = [found[2] for found in _FENCE.findall(text)]
    blocks.append("\n".join(line for line in prose(text).splitlines() if line.startswith("    ")))
    for block in blocks:
        for line in re.sub(r"\\\n\s*", " ", block).splitlines():
            found = _COMMAND.match(line.strip())
            if found and not re.match(r"[:\[{]|[\d.]+ *$", found["words"]):
                yield found["words"]


def options_of(command: str) -> list[str]:
    """Return a command's words without comment and redirections, [optional parts] included."""
    words = []
    for word in shlex.split(command.replace("[", " ").replace("]", " "), comments=True):
        if word in _ENDS:
            break
        words.append(word.removesuffix(";"))
    return [word for word in words if word not in ("…", "...")]


COMMANDS = sorted({(ids(page), command) for page in PAGES for command in commands(page)})


@pytest.mark.parametrize(("page", "command"), COMMANDS)
def test_every_command_parses(page: str, command: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = options_of(command)
    try:
        cli.build_parser().parse_args(words)
    except SystemExit as error:
        if error.code:
            pytest.fail(f"{page}: deltacharger {command}\n{capsys.readouterr().err}")


def test_commands_are_found() -> None:
    assert len(COMMANDS) > 50
    assert {words.split()[0] for _, words in COMMANDS} >= {"up", "dock", "undock", "doctor", "calibrate", "tactile"}


@cache
def definitions(path: Path) -> frozenset[str]:
    """Return dotted names defined by a module: functions, classes, constants, methods and attributes."""
    found: set[str] = set()

    def take(body: list[ast.stmt], prefix: str) -> None:
        for node in body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                found.add(prefix + node.name)
                if isinstance(node, ast.ClassDef):
                    take(node.body, f"{prefix}{node.name}.")
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                found.update(prefix + target.id for target in targets if isinstance(target, ast.Name))

    take(ast.parse(path.read_text(encoding="utf-8")).body, "")
    return frozenset(found)


def is_defined(name: str) -> bool:
    """Return whether a dotted name exists: `package.module.Class.name` without `deltacharger_`, or `Class.field`."""
    parts = name.removeprefix("deltacharger_").split(".")
    for count in range(len(parts), 1, -1):
        path = ROOT / ("deltacharger_" + "/".join(parts[:count]) + ".py")
        if path.exists():
            return count == len(parts) or ".".join(parts[count:]) in definitions(path)
    return any(name in definitions(path) for package in PACKAGES for path in package.rglob("*.py"))


def is_there(name: str) -> bool:
    """Return whether a path exists: from the repository root, or a file or folder/ name in any package."""
    if (ROOT / name).exists():
        return True
    name = name.removesuffix("/")
    return "/" not in name and any(True for package in PACKAGES for _ in package.rglob(name))


def test_every_name_in_the_tour_exists() -> None:
    missing = []
    for quoted in _QUOTED.findall(prose(TOUR.read_text(encoding="utf-8"))):
        if " " in quoted or quoted.startswith("-") or quoted in _FILE_SUFFIXES:
            continue
        if "/" in quoted or quoted.endswith(_FILE_SUFFIXES):
            if not quoted.startswith("_") and not is_there(quoted):
                missing.append(quoted)
        elif _DOTTED.fullmatch(quoted) and not is_defined(quoted):
            missing.append(quoted)
    assert not missing, f"docs/tour.md has unknown names: {', '.join(missing)}"


def threads() -> Iterator[tuple[Path, str]]:
    """Yield module and function of every thread started by the packages."""
    for package in PACKAGES:
        for path in sorted(package.rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("Thread"):
                    target = next((each.value for each in node.keywords if each.arg == "target"), None)
                    if target is not None:
                        yield path, ast.unparse(target).rpartition(".")[2]


def test_the_tour_names_every_thread() -> None:
    section = TOUR.read_text(encoding="utf-8").partition("### Every thread")[2].partition("\n## ")[0]
    rows = [row for row in section.splitlines() if row.startswith("| `")]
    found = list(threads())
    assert len(found) > 10
    for path, function in found:
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removeprefix("deltacharger_")
        named = any(f"`{module}." in row for row in rows)
        assert named, f"docs/tour.md, 'Every thread': a row for {module} ({function}) is missing"


def test_the_table_lists_every_code_and_whether_it_is_retriable() -> None:
    page = (ROOT / "docs" / "errors.md").read_text(encoding="utf-8")
    rows = {
        cells[1].strip(): [cell.strip() for cell in cells]
        for line in page.splitlines()
        if (cells := line.split("|")) and len(cells) == 8 and cells[1].strip().isdigit()
    }
    assert set(rows) == {str(int(code)) for code in codes.Code}
    errors = [kind for kind in vars(codes).values() if isinstance(kind, type) and issubclass(kind, codes.DockingError)]
    for code in codes.Code:
        _, _, name, again, cause, *_ = rows[str(int(code))]
        assert name == code.name
        assert cause
        retriable = {kind.retriable for kind in errors if kind.code is code}
        if retriable == {True}:
            assert again == "yes", name
        elif retriable == {False}:
            assert again == "no", name
        elif retriable:
            assert again not in ("yes", "no"), name


def test_the_index_lists_every_page() -> None:
    index = ROOT / "docs" / "README.md"
    linked = {
        (index.parent / each.partition("#")[0]).resolve() for each in _LINK.findall(index.read_text(encoding="utf-8"))
    }
    pages = {path for path in (ROOT / "docs").rglob("*.md") if path != index}
    assert pages <= linked, f"docs/README.md lacks {', '.join(sorted(map(os.path.basename, pages - linked)))}"
