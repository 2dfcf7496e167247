# SPDX-License-Identifier: Apache-2.0
"""Which libraries a module brings along, read from the sources: nothing is imported to find that out."""

from __future__ import annotations

import ast
import functools
import importlib.util
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

_OURS = "deltacharger_"


@dataclass(frozen=True)
class Imports:
    """What one module imports by itself.

    Attributes:
        at_once: modules that its own import loads.
        when_used: modules that some function of it loads.
    """

    at_once: frozenset[str]
    when_used: frozenset[str]


@dataclass(frozen=True)
class Libraries:
    """Libraries behind some modules, with all that these import.

    Attributes:
        at_once: loaded with the modules, whatever they then do.
        when_used: loaded once a function needs them; each with the modules that have such a function.
    """

    at_once: frozenset[str]
    when_used: dict[str, list[str]]


def libraries(modules: Iterable[str], apart: Iterable[str] = ()) -> Libraries:
    """Return the libraries, other than Python's own, that these modules of ours need.

    Args:
        modules: dotted names.
        apart: modules that stand for themselves: a function that imports one of them does not count.
    """
    at_once, known = _closure(modules, frozenset())
    later: dict[str, set[str]] = {}
    left, seen = list(known), set(known)
    while left:
        module = left.pop()
        for name in _imports(module).when_used:
            if _is_ours(name):
                libraries_there, modules_there = _closure([name], frozenset(apart))
                for library in libraries_there:
                    later.setdefault(library, set()).add(name)
                fresh = modules_there - seen
                seen |= fresh
                left += fresh
            else:
                later.setdefault(_root(name), set()).add(module)
    when_used = {name: sorted(later[name]) for name in sorted(later) if name not in at_once and _is_library(name)}
    return Libraries(frozenset(name for name in at_once if _is_library(name)), when_used)


def _closure(modules: Iterable[str], apart: frozenset[str]) -> tuple[set[str], set[str]]:
    """Return libraries, and modules of ours, that importing these modules loads; `apart` are not followed."""
    found: set[str] = set()
    left, seen = list(modules), set[str]()
    while left:
        module = left.pop()
        if module in seen or module in apart:
            continue
        seen.add(module)
        for name in _imports(module).at_once:
            if _is_ours(name):
                left.append(name)
            else:
                found.add(_root(name))
    return found, seen


@functools.cache
def _imports(module: str) -> Imports:
    """Return what a module of ours imports, and the packages that lead to it."""
    source = _source(module)
    parts = module.split(".")
    packages = {".".join(parts[:count]) for count in range(1, len(parts))}
    if source is None:
        return Imports(frozenset(packages), frozenset())
    tree = ast.parse(source.read_text(encoding="utf-8"))
    package = module if source.name == "__init__.py" else module.rpartition(".")[0]
    at_once = {name for node in _outside_functions(tree) for name in _named(node, package)}
    everywhere = {name for node in ast.walk(tree) for name in _named(node, package)}
    hints = {name for node in _for_hints(tree) for name in _named(node, package)}
    return Imports(frozenset(at_once | packages), frozenset(everywhere - at_once - hints))


def _outside_functions(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the statements that importing the module runs, without those for type checkers."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) or _is_for_hints(node):
            continue
        yield node
        yield from _outside_functions(node)


def _for_hints(tree: ast.AST) -> Iterator[ast.AST]:
    for node in ast.walk(tree):
        if _is_for_hints(node):
            yield from ast.walk(node)


def _is_for_hints(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def _named(node: ast.AST, package: str) -> Iterator[str]:
    """Yield the modules that an import statement names."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        base = node.module or ""
        if node.level:
            base = ".".join([*package.split(".")[: len(package.split(".")) - node.level + 1], base]).strip(".")
        yield base
        if _is_ours(base):
            yield from (f"{base}.{alias.name}" for alias in node.names if _source(f"{base}.{alias.name}") is not None)


@functools.cache
def _source(module: str) -> Path | None:
    """Return the file of a module of ours; None where there is none of this name."""
    package, *inner = module.split(".")
    spec = importlib.util.find_spec(package)
    if spec is None or not spec.origin:
        return None
    path = Path(spec.origin).parent.joinpath(*inner)
    for file in (path / "__init__.py", path.with_suffix(".py")):
        if file.is_file():
            return file
    return None


def _is_ours(name: str) -> bool:
    return name.startswith(_OURS)


def _root(name: str) -> str:
    return name.split(".")[0]


def _is_library(name: str) -> bool:
    return name not in sys.stdlib_module_names and not _is_ours(name) and name not in ("", "__future__")
