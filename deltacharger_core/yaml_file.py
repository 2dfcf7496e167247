# SPDX-License-Identifier: Apache-2.0
"""YAML as people mean it, for every file that one writes: `1e-3` is a number, and a key given twice is a mistake.

PyYAML is loaded with the first file.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from deltacharger_core.files import write_text

# YAML 1.1 calls 1e5 and 1e-3 strings, since it wants a dot and a sign; YAML 1.2 and people do not.
_EXPONENT = re.compile(r"^[-+]?(?:[0-9][0-9_]*)(?:\.[0-9_]*)?[eE][-+]?[0-9]+$")


class YamlError(ValueError):
    """A file is not readable YAML.

    Attributes:
        file: its path.
        problem: where and why, e.g. "line 2: the key 'nodes' is given twice".
    """

    def __init__(self, file: str | Path, problem: str) -> None:
        self.file = str(file)
        self.problem = problem
        super().__init__(f"{file}: {problem}")


def read_yaml(path: str | Path, *, first: bool = False) -> Any:
    """Return the content of a YAML file.

    Args:
        path: of the file.
        first: of several documents, such as an echoed topic's, take the first; otherwise there may be one only.

    Raises:
        OSError: the file cannot be read.
        YamlError: it is not YAML, a key is given twice or is no word.
    """
    import yaml

    try:
        text = Path(path).read_text(encoding="utf-8")
        return next(yaml.load_all(text, Loader=_loader()), None) if first else yaml.load(text, Loader=_loader())
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark is not None else ""
        raise YamlError(path, f"not valid YAML: {where}{error.problem}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # also text in no UTF-8, and a 31st of February
        raise YamlError(path, f"not valid YAML: {error}") from error


def write_yaml(path: str | Path, content: Mapping[str, Any], comment: str = "") -> None:
    """Write a mapping in its own order, `comment` above it; whole or not at all.

    Args:
        path: of the file.
        content: plain numbers, text, lists and mappings.
        comment: may have several lines.

    Raises:
        OSError: the file cannot be written.
    """
    head = "".join(f"# {line}".rstrip() + "\n" for line in comment.splitlines())
    write_text(path, head + yaml_text(content))


def yaml_text(content: Mapping[str, Any]) -> str:
    """Return what `write_yaml` writes."""
    import yaml

    return str(yaml.safe_dump(dict(content), sort_keys=False, default_flow_style=None, width=120))


@functools.cache
def _loader() -> Any:
    import yaml

    class Loader(yaml.SafeLoader):
        pass

    def mapping(loader: Any, node: Any) -> dict[Any, Any]:
        seen: set[str] = set()
        for key_node, _ in node.value:
            key, mark = loader.construct_object(key_node, deep=True), key_node.start_mark
            wrong = "is not a word" if not isinstance(key, str) else "is given twice" if key in seen else ""
            if wrong:
                raise yaml.constructor.ConstructorError(None, None, f"the key {key!r} {wrong}", mark)
            seen.add(key)
        return dict(yaml.SafeLoader.construct_mapping(loader, node))

    Loader.add_implicit_resolver("tag:yaml.org,2002:float", _EXPONENT, list("-+0123456789"))
    Loader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, mapping)
    return Loader
