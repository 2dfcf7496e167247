# SPDX-License-Identifier: Apache-2.0
"""Checks the documentation: links have targets, commands parse, names exist."""

import os
import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from deltacharger_bringup.cli import main as cli
from deltacharger_bringup.launch_arguments import CHARGER, VIEW, in_launch
from deltacharger_docking import codes

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "examples/*.md")
    for path in ROOT.glob(pattern)
    if not path.name.startswith(".")
)
MODULES = sorted(ROOT.glob("deltacharger_*/**/*.py"))
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


def test_every_link_has_a_target() -> None:
    wrong = []
    for page in PAGES:
        for target in _LINK.findall(prose(page.read_text(encoding="utf-8"))):
            name, _, anchor = target.partition("#")
            path = (page.parent / name).resolve() if name else page
            if not re.match(r"[a-z]+:", target) and not (
                path.exists() and (not anchor or path.suffix != ".md" or anchor in anchors(path))
            ):
                wrong.append(f"{ids(page)}: {target}")
    assert not wrong


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


def test_every_command_parses(capsys: pytest.CaptureFixture[str]) -> None:
    found = sorted({(command, ids(page)) for page in PAGES for command in commands(page)})
    assert len(found) > 50
    assert {words.split()[0] for words, _ in found} >= {"up", "dock", "undock", "doctor", "calibrate", "tactile"}
    known = cli.every_command()
    parser, wrong = cli.build_parser(known), []
    for command, page in found:
        if any(command.startswith(name) and name not in known for name in cli.LABORATORY):
            continue  # the laboratory is not installed
        try:
            parser.parse_args(options_of(command))
        except SystemExit as error:
            wrong += [f"{page}: {command}\n{capsys.readouterr().err}"] if error.code else []
    assert not wrong, "\n".join(wrong)


def test_every_launch_argument_exists() -> None:
    options = {"charger": CHARGER, "view": VIEW}
    for path in (*PAGES, *ROOT.glob("launch/*.py")):
        for file, line in re.findall(r"(charger|view)\.launch\.py(.*)", path.read_text(encoding="utf-8")):
            given = set(re.findall(r"(\w+):=", line))
            assert given <= {in_launch(name) for name in options[file]}, f"{ids(path)}: {line}"


def is_defined(name: str) -> bool:
    """Return whether a dotted name exists: `package.module.Class.name` without `deltacharger_`, or `Class.field`."""
    parts = name.removeprefix("deltacharger_").split(".")
    paths = [ROOT / ("deltacharger_" + "/".join(parts[:count]) + ".py") for count in range(len(parts), 1, -1)]
    here = next(((path, parts[-index:] if index else []) for index, path in enumerate(paths) if path.exists()), None)
    for path, names in [here] if here else [(path, parts) for path in MODULES]:
        text = path.read_text(encoding="utf-8")
        if all(re.search(rf"^ *((async )?def |class )?{each}\b( ?[:=(]|$)", text, re.MULTILINE) for each in names):
            return True
    return False


def is_there(name: str) -> bool:
    """Return whether a path exists: from the repository root, or a file or folder/ name in any package."""
    name = name.removesuffix("/")
    return (ROOT / name).exists() or any(True for _ in ROOT.glob(f"deltacharger_*/**/{name}"))


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


def test_the_tour_names_every_thread() -> None:
    section = TOUR.read_text(encoding="utf-8").partition("### Every thread")[2].partition("\n## ")[0]
    rows = [row for row in section.splitlines() if row.startswith("|`")]
    found = [path for path in MODULES if re.search(r"Thread\([^)]*target=", path.read_text(encoding="utf-8"))]
    assert len(found) > 10
    for path in found:
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removeprefix("deltacharger_")
        assert any(f"`{module}." in row for row in rows), f"docs/tour.md, 'Every thread': a row for {module} is missing"


def test_the_table_lists_every_code_and_whether_it_is_retriable() -> None:
    page = (ROOT / "docs" / "errors.md").read_text(encoding="utf-8")
    lines = [[cell.strip() for cell in line.split("|")] for line in page.splitlines()]
    rows = {int(cells[1]): cells for cells in lines if len(cells) == 8 and cells[1].isdigit()}
    errors = [kind for kind in vars(codes).values() if isinstance(kind, type) and issubclass(kind, codes.DockingError)]
    assert {number: cells[2] for number, cells in rows.items()} == {int(code): code.name for code in codes.Code}
    for code in codes.Code:
        _, _, name, again, cause, *_ = rows[int(code)]
        assert cause
        retriable = {kind.retriable for kind in errors if kind.code is code}
        plain = {frozenset({True}): "yes", frozenset({False}): "no"}.get(frozenset(retriable))
        assert not retriable or (again == plain if plain else again not in ("yes", "no")), name


def test_the_index_lists_every_page() -> None:
    index = ROOT / "docs" / "README.md"
    linked = {
        (index.parent / each.partition("#")[0]).resolve() for each in _LINK.findall(index.read_text(encoding="utf-8"))
    }
    pages = {path for path in (ROOT / "docs").rglob("*.md") if path != index}
    assert pages <= linked, f"docs/README.md lacks {', '.join(sorted(map(os.path.basename, pages - linked)))}"
