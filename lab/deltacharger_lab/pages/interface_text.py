# SPDX-License-Identifier: Apache-2.0
"""Content of .msg, .srv and .action files for the page of topics: fields, constants, and their comments."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

PARTS = {".msg": ("",), ".srv": ("Request", "Response"), ".action": ("Goal", "Result", "Feedback")}
_LICENCE = "SPDX-License-Identifier:"
_DECLARATION = re.compile(
    r"(?P<type>\S+)\s+(?P<name>\w+)\s*(?P<constant>=\s*\S+)?\s*(?P<default>[^#=]*)(#\s*(?P<text>.*))?"
)


@dataclass
class Field:
    """One field: its name, type as written, default ('' = the type's own) and comment."""

    name: str
    type: str
    default: str
    text: str


@dataclass
class InterfacePart:
    """One part of an interface, such as an action's goal; a message has one without a name."""

    name: str
    fields: list[Field] = field(default_factory=list)
    constants: list[str] = field(default_factory=list)


@dataclass
class Interface:
    """One interface file: the comment at its head and its parts."""

    name: str
    text: str
    parts: list[InterfacePart]


def read(path: Path) -> Interface:
    """Read an interface file.

    Raises:
        ValueError: a line is not a declaration, or the number of parts does not fit the kind of file.
    """
    names = PARTS[path.suffix]
    pieces = re.split(r"^---$", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    if len(pieces) != len(names):
        raise ValueError(f"{path}: {len(pieces)} parts; a {path.suffix} file has {len(names)}")
    head: list[str] = []
    parts = [_part(path, name, piece, head) for name, piece in zip(names, pieces, strict=True)]
    return Interface(path.stem, " ".join(head), parts)


def _part(path: Path, name: str, piece: str, head: list[str]) -> InterfacePart:
    part = InterfacePart(name)
    for line in filter(str.strip, piece.splitlines()):
        comment = line.strip().removeprefix("#").strip()
        if comment.startswith(_LICENCE):
            continue
        if line.startswith("#"):
            head.append(comment)
        elif line.lstrip().startswith("#"):  # continues the line above
            part.fields[-1].text += f" {comment}"
        else:
            _declare(path, part, line)
    return part


def _declare(path: Path, part: InterfacePart, line: str) -> None:
    found = _DECLARATION.fullmatch(line.strip())
    if found is None:
        raise ValueError(f"{path}: '{line}' declares nothing")
    if found["constant"]:
        part.constants.append(f"{found['name']} {found['constant'].removeprefix('=').strip()}")
    else:
        part.fields.append(Field(found["name"], found["type"], found["default"].strip(), found["text"] or ""))
