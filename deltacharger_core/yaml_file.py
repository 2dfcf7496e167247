# SPDX-License-Identifier: Apache-2.0
"""Reads and writes YAML with the usual expectations: `1e-3` is a number, a repeated key is an error.

Content of untrusted files is plain and bounded: no aliases, dates or objects, integers of at most 64 bits. PyYAML is
imported with the first file.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from deltacharger_core.bounded_file import LARGEST_TEXT, FileRefused, brief, read_bytes
from deltacharger_core.files import write_text
from deltacharger_core.parameters import ParameterError, from_mapping
from deltacharger_core.picklable import Picklable

T = TypeVar("T")

_DEEPEST, _MOST = 30, 50_000  # levels; values and keys of a file
_LONGEST_KEY, _LONGEST_NUMBER, _LONGEST_PROBLEM = 100, 100, 300  # characters
_TAG = "tag:yaml.org,2002:"
_SCALARS = ("null", "bool", "int", "float", "str")

_OPENCV_HEADER = b"%YAML:1.0"

# In YAML 1.1 (unlike 1.2) 1e5 and 1e-3 are strings, because a float needs a dot and a sign.
_EXPONENT = re.compile(r"^[-+]?(?:[0-9][0-9_]*)(?:\.[0-9_]*)?[eE][-+]?[0-9]+$")


class YamlError(Picklable, ValueError):
    """A file is not valid YAML.

    Attributes:
        file: path.
        problem: place and reason, e.g. "line 2: the key 'nodes' is given twice".
    """

    def __init__(self, file: str | Path, problem: str) -> None:
        self.file = str(file)
        self.problem = problem
        super().__init__(f"{file}: {problem}")


def read_yaml(path: str | Path, *, first: bool = False) -> Any:
    """Return the content of a YAML file: None, booleans, numbers, text, and lists and mappings of these.

    Args:
        path: file.
        first: read the first of several documents (e.g. of `ros2 topic echo`); otherwise only one is allowed.

    Raises:
        OSError: the file cannot be read.
        YamlError: it is no regular file, larger than 1 MB or not YAML; a key is repeated or no text; it holds an
            alias, a tag of another type, more than 50 000 values or 30 levels, or an integer of more than 64 bits.
    """
    import yaml

    try:
        content = read_bytes(path, LARGEST_TEXT)
    except FileRefused as error:
        raise YamlError(path, str(error.strerror)) from error
    try:
        loader = _loader()(_plain(content).decode("utf-8"))
        try:
            node = loader.get_single_node() if not first else loader.get_node() if loader.check_node() else None
            return None if node is None else loader.value(node)
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark is not None else ""
        raise YamlError(path, f"not valid YAML: {where}{error.problem}"[:_LONGEST_PROBLEM]) from error
    except (yaml.YAMLError, ValueError) as error:  # also text that is not UTF-8
        raise YamlError(path, f"not valid YAML: {error}"[:_LONGEST_PROBLEM]) from error


def _plain(content: bytes) -> bytes:
    """Return YAML without OpenCV's own header and tag, which no other reader knows."""
    if not content.startswith(_OPENCV_HEADER):
        return content
    return content.removeprefix(_OPENCV_HEADER).replace(b"!!opencv-matrix", b"")


def read_declared(path: str | Path, kind: type[T]) -> T:
    """Return a YAML file as a dataclass of declared parameters; missing keys keep their defaults.

    Raises:
        OSError: the file cannot be read.
        ValueError: the file is no YAML or has an unknown key or invalid value; names file and key.
    """
    content = read_yaml(path)
    try:
        return from_mapping({} if content is None else content, kind)
    except ParameterError as error:
        raise ValueError(f"{path}: {error}") from error


def write_yaml(path: str | Path, content: Mapping[str, Any], comment: str = "") -> None:
    """Write a mapping atomically, in its own order, with `comment` above it.

    Args:
        path: file.
        content: plain numbers, text, lists and mappings.
        comment: may have several lines.

    Raises:
        OSError: the file cannot be written.
    """
    head = "".join(f"# {line}".rstrip() + "\n" for line in comment.splitlines())
    write_text(path, head + yaml_text(content))


def yaml_text(content: Mapping[str, Any]) -> str:
    """Return a mapping as YAML, as `write_yaml` writes it."""
    import yaml

    class Dumper(yaml.SafeDumper):
        def ignore_aliases(self, data: Any) -> bool:
            return True  # `read_yaml` refuses aliases

    return str(yaml.dump(dict(content), Dumper=Dumper, sort_keys=False, default_flow_style=None, width=120))


@functools.cache
def _loader() -> Any:
    """Return a bounded loader class, based on libyaml if PyYAML has it."""
    import yaml

    base: Any = yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader
    construct = {f"{_TAG}{kind}": getattr(base, f"construct_yaml_{kind}") for kind in _SCALARS}

    def refused(node: Any, problem: str) -> yaml.MarkedYAMLError:
        return yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)

    class Loader(base):  # type: ignore[misc]
        def __init__(self, text: str) -> None:
            super().__init__(text)
            self.depth = self.count = 0
            self.met: set[int] = set()  # ids of nodes; the tree keeps the nodes alive, so ids stay unique

        def descend_resolver(self, parent: Any, index: Any) -> None:
            """PyYAML calls it before it composes each node and the nodes inside."""
            self.depth, self.count = self.depth + 1, self.count + 1
            if self.depth > _DEEPEST or self.count > _MOST:
                much = f"nested deeper than {_DEEPEST} levels" if self.depth > _DEEPEST else f"more than {_MOST} values"
                raise yaml.MarkedYAMLError(problem=much, problem_mark=parent.start_mark)

        def ascend_resolver(self) -> None:
            self.depth -= 1

        def resolve(self, kind: Any, value: Any, implicit: Any) -> Any:
            if kind is yaml.ScalarNode and len(value) > _LONGEST_NUMBER and implicit != (False, True):
                implicit = (False, True)  # text, as if quoted
            return super().resolve(kind, value, implicit)

        def value(self, node: Any) -> Any:
            """Return a node's value."""
            if id(node) in self.met:
                raise refused(node, "is used again by an alias; write it out in each place")
            self.met.add(id(node))
            kind = node.tag.removeprefix(_TAG)
            if isinstance(node, yaml.MappingNode) and kind == "map":
                return self.mapping(node)
            if isinstance(node, yaml.SequenceNode) and kind == "seq":
                return [self.value(each) for each in node.value]
            if not isinstance(node, yaml.ScalarNode) or kind not in _SCALARS:
                raise refused(node, f"the tag {brief(node.tag)} is unknown; remove it")
            try:
                found = construct[node.tag](self, node)
            except (ValueError, LookupError) as error:
                raise refused(node, f"{brief(node.value)} is not of the type of its tag {kind}") from error
            if isinstance(found, int) and not -(2**63) <= found < 2**63:
                raise refused(node, f"the whole number {brief(node.value)} has more than 64 bits")
            return found

        def mapping(self, node: Any) -> dict[str, Any]:
            found: dict[str, Any] = {}
            for key_node, value_node in node.value:
                key = self.value(key_node)
                wrong = "is not text" if not isinstance(key, str) else "is given twice" if key in found else ""
                wrong = wrong or ("is too long" if len(key) > _LONGEST_KEY else "")
                if wrong:
                    raise refused(key_node, f"the key {brief(key)} {wrong}")
                found[key] = self.value(value_node)
            return found

    Loader.yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in resolvers if tag.removeprefix(_TAG) in _SCALARS]
        for first, resolvers in base.yaml_implicit_resolvers.items()
    }
    Loader.add_implicit_resolver(f"{_TAG}float", _EXPONENT, list("-+0123456789"))
    return Loader
