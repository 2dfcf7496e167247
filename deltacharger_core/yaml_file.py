# SPDX-License-Identifier: Apache-2.0
"""Reads and writes YAML with the usual expectations: `1e-3` is a number, a repeated key is an error.

Content of untrusted files is plain and bounded: text, numbers, lists and mappings, without aliases and objects. PyYAML
is imported with the first file.
"""

import functools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from deltacharger_core import files, parameters

T = TypeVar("T")

_DEEPEST, _MOST = 30, 50_000  # levels; values and keys of a file
_LONGEST_PROBLEM = 300  # characters
_TAG = "tag:yaml.org,2002:"
_PLAIN = ("null", "bool", "int", "float")  # besides text, lists and mappings

# In YAML 1.1 (unlike 1.2) 1e5 and 1e-3 are strings, because a float needs a dot and a sign.
_EXPONENT = re.compile(r"^[-+]?(?:[0-9][0-9_]*)(?:\.[0-9_]*)?[eE][-+]?[0-9]+$")


class YamlError(ValueError):
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
            alias, a tag of another type, or more than 50 000 values or 30 levels.
    """
    import yaml

    try:
        content = files.read_bytes(path, files.LARGEST_TEXT)
    except files.FileRefused as error:
        raise YamlError(path, str(error.strerror)) from error
    try:
        text = content.decode("utf-8")
        _bound(text)
        documents = yaml.load_all(text, _loader())
        found = next(documents, None)
        if not first and next(documents, None) is not None:
            raise ValueError("it holds several documents: give one")
        return found
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark is not None else ""
        raise YamlError(path, f"not valid YAML: {where}{error.problem}"[:_LONGEST_PROBLEM]) from error
    except (yaml.YAMLError, ValueError) as error:  # also text that is not UTF-8
        raise YamlError(path, f"not valid YAML: {error}"[:_LONGEST_PROBLEM]) from error


def read_declared(path: str | Path, kind: type[T]) -> T:
    """Return a YAML file as a dataclass of declared parameters; missing keys keep their defaults.

    Raises:
        OSError: the file cannot be read.
        ValueError: the file is no YAML or has an unknown key or invalid value; names file and key.
    """
    content = read_yaml(path)
    try:
        return parameters.from_mapping({} if content is None else content, kind)
    except parameters.ParameterError as error:
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
    import yaml

    class Dumper(yaml.SafeDumper):
        def ignore_aliases(self, data: Any) -> bool:
            return True  # `read_yaml` refuses aliases

    head = "".join(f"# {line}".rstrip() + "\n" for line in comment.splitlines())
    text = yaml.dump(dict(content), Dumper=Dumper, sort_keys=False, default_flow_style=None, width=120)
    files.write_text(path, head + text)


def _bound(text: str) -> None:
    """Raise MarkedYAMLError for aliases, too many levels or values, before anything is built of them."""
    import yaml

    depth = 0
    for count, event in enumerate(yaml.parse(text, _base())):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        problem = "an alias; write it out in each place" if isinstance(event, yaml.AliasEvent) else ""
        problem = f"nested deeper than {_DEEPEST} levels" if depth > _DEEPEST else problem
        problem = f"more than {_MOST} values" if count > _MOST else problem
        if problem:
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)  # type: ignore[arg-type]


def _base() -> Any:
    import yaml

    return yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader


@functools.cache
def _loader() -> Any:
    """Return a loader of plain values that refuses repeated keys; on libyaml if PyYAML has it."""
    import yaml

    class Loader(_base()):  # type: ignore[misc]
        def construct_mapping(self, node: Any, deep: bool = False) -> dict[str, Any]:
            found: dict[str, Any] = {}
            for key_node, value_node in node.value:
                key = self.construct_object(key_node, deep=True)
                wrong = "is not text" if not isinstance(key, str) else "is given twice" if key in found else ""
                if wrong:
                    problem = f"the key {files.brief(key)} {wrong}"
                    raise yaml.MarkedYAMLError(problem=problem, problem_mark=key_node.start_mark)
                found[key] = self.construct_object(value_node, deep=deep)
            return found

    kept = {*(f"{_TAG}{kind}" for kind in (*_PLAIN, "str", "seq", "map")), None}  # None refuses a tag by name
    Loader.yaml_constructors = {tag: build for tag, build in Loader.yaml_constructors.items() if tag in kept}
    Loader.yaml_implicit_resolvers = {  # no dates, no merge keys
        first: [(tag, pattern) for tag, pattern in resolvers if tag.removeprefix(_TAG) in _PLAIN]
        for first, resolvers in Loader.yaml_implicit_resolvers.items()
    }
    Loader.add_implicit_resolver(f"{_TAG}float", _EXPONENT, list("-+0123456789"))
    return Loader
