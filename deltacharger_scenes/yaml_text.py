# SPDX-License-Identifier: Apache-2.0
"""YAML as people mean it: `1e5` is a number, and a key given twice is a mistake rather than a silent choice."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml


class YamlProblem(ValueError):
    """A file is not readable YAML. The message says where and why."""


class _Loader(yaml.SafeLoader):
    pass


# YAML 1.1 calls 1e5 and 1e-3 strings, since it wants a dot and a sign; YAML 1.2 and people do not.
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(?:[0-9][0-9_]*)(?:\.[0-9_]*)?[eE][-+]?[0-9]+$"),
    list("-+0123456789"),
)


def _unique_mapping(loader: _Loader, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
    seen: set[Any] = set()
    for key_node, _ in node.value:
        key = loader.construct_object(key_node, deep=True)
        if not isinstance(key, str):
            raise YamlProblem(f"line {key_node.start_mark.line + 1}: the key {key!r} is not a word")
        if key in seen:
            raise YamlProblem(f"line {key_node.start_mark.line + 1}: the key '{key}' is given twice")
        seen.add(key)
    return yaml.SafeLoader.construct_mapping(loader, node, deep)


_Loader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _unique_mapping)


def read_yaml(path: Path) -> Any:
    """Return the content of a YAML file.

    Raises:
        YamlProblem: it is not a readable file or not YAML.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise YamlProblem(f"cannot be read: {error}") from error
    try:
        return yaml.load(text, Loader=_Loader)  # a SafeLoader underneath
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark is not None else ""
        raise YamlProblem(f"not valid YAML: {where}{error.problem}") from error
    except yaml.YAMLError as error:
        raise YamlProblem(f"not valid YAML: {error}") from error
