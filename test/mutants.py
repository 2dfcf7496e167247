# SPDX-License-Identifier: Apache-2.0
"""Breaks lines on which safety depends, one at a time, and shows which of them the quick tests notice (`make mutants`).

Each mutant of mutants.yaml replaces a text, which stands once in its file (if that is gone: once in the product). In a
copy of the tree runs first the table of safety numbers, then the quick tests that mirror the broken module: those files
of its package's folder in test/ that import it, or the whole folder if none does.

    python test/mutants.py run [NAME…]           all mutants, or those whose names contain a word
    python test/mutants.py draw --seed 48 --count 50    print drawn mutants of safety code as YAML
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import queue
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import yaml

ROOT = Path(__file__).resolve().parents[1]
TABLE = "test/core/test_safety_numbers.py"
AT_LEAST = 0.9
SIDE_BY_SIDE = 2
# Code that decides about contact, current, motion or what is believed; paths as of the draw.
SAFETY = {
    "docking/": "clearance energy charging goals place target_place ease press touch contact_current machine context "
    "release wired springs parameters visit",
    "docking/ros/": "frame_check inputs messages",
    "driver/": "parameters",
    "driver/board/": "contactor_guard contactor_lease device_clock heartbeat receiver payloads protocol",
    "driver/servos/": "motion_guard trajectory thermal snapshot goals controller mx64",
    "driver/emulators/": "board power pads",
    "vision/": "mount",
    "vision/detector/": "judgement support",
    "mission/": "machine context places",
    "sim/": "circuit parameters",
    "tactile/": "contact pose_judgement parameters frame_window",
    "core/": "servos_file parameters",
}
NEGATED = {"<": ">=", ">=": "<", ">": "<=", "<=": ">", "==": "!=", "!=": "=="}
UNCHECKED = {
    "math.isfinite": "(lambda value: True)",
    "math.isnan": "(lambda value: False)",
    "np.isfinite": "np.isreal",
    "np.isnan": "np.iscomplex",
}


class Mutant(NamedTuple):
    name: str
    file: str
    text: str
    becomes: str
    tests: str = ""

    def place(self, tree: Path) -> Path:
        """Return the only file whose text it replaces."""
        found = [path for path in [tree / self.file] if path.is_file() and self.text in path.read_text()]
        found = found or [path for path in tree.glob("deltacharger_*/**/*.py") if self.text in path.read_text()]
        if len(found) != 1 or (times := found[0].read_text().count(self.text)) != 1:
            where = f"{times} times in {self.file}" if len(found) == 1 else f"in {len(found)} files"
            raise SystemExit(f"mutant '{self.name}' must replace exactly one text, which is {where}: {self.text}")
        return found[0]

    def suites(self, tree: Path) -> list[list[str]]:
        """Return what to run, in turn: the table of safety numbers, then the tests that mirror its file."""
        package, *names = self.place(tree).relative_to(tree).with_suffix("").parts
        folder = tree / package.replace("deltacharger_", "test/")
        parent, module = ".".join((package, *names[:-1])), names[-1]
        imported = re.compile(rf"(import|from) {parent}\.{module}\b|from {parent} import .*\b{module}\b")
        near = [str(path) for path in sorted(folder.rglob("test_*.py")) if imported.search(path.read_text())]
        return [[TABLE], self.tests.split() or near or [str(folder)]]


def mutants(words: list[str]) -> list[Mutant]:
    every = [Mutant(**row) for row in yaml.safe_load((ROOT / "test/mutants.yaml").read_text())]
    return [one for one in every if not words or any(word in one.name for word in words)]


# Running.


def copy(folder: Path) -> Path:
    """Copy what git tracks or would track."""
    listed = ["git", "-C", ROOT, "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    for name in filter(None, subprocess.check_output(listed, text=True).split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def failure(tests: list[str], tree: Path, domain: int, marks: str) -> str:
    """Return the first test that fails in a copy, '' if none does."""
    # The copy comes before the editable install in every process that a test starts, and compiled files are its own.
    env = os.environ | {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1", "ROS_DOMAIN_ID": str(domain)}
    call = [sys.executable, "-m", "pytest", "-xq", "-p", "no:cacheprovider", "-m", marks, *tests]
    done = subprocess.run(call, cwd=tree, env=env, capture_output=True, text=True)
    found = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    return "" if done.returncode in (0, 5) else found[1] if found else f"pytest ended with {done.returncode}"


def killer(mutant: Mutant, tree: Path, domain: int, marks: str) -> str:
    """Return the first test that fails with this mutant, '' if none does."""
    path, suites = mutant.place(tree), mutant.suites(tree)
    whole = path.read_text()
    path.write_text(whole.replace(mutant.text, mutant.becomes))
    try:
        return next((failed for suite in suites if (failed := failure(suite, tree, domain, marks))), "")
    finally:
        path.write_text(whole)


def run(words: list[str], marks: str) -> int:
    chosen = mutants(words)
    for mutant in chosen:
        mutant.place(ROOT)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(SIDE_BY_SIDE) as workers:
        trees: queue.Queue[tuple[Path, int]] = queue.Queue()
        for index in range(SIDE_BY_SIDE):
            trees.put((copy(Path(folder) / str(index)), 90 + index))
            if failed := failure([TABLE], *trees.queue[-1], marks):
                raise SystemExit(f"{failed} fails without a mutant")

        def strike(mutant: Mutant) -> str:
            tree, domain = trees.get()
            try:
                return killer(mutant, tree, domain, marks)
            finally:
                trees.put((tree, domain))

        survivors = []
        for mutant, died_by in zip(chosen, workers.map(strike, chosen), strict=True):
            print(f"{'died    ' if died_by else 'SURVIVED'} {mutant.name:60} {died_by}", flush=True)
            if not died_by:
                survivors.append(mutant.name)
    share = 1.0 - len(survivors) / len(chosen)
    print(f"{len(chosen) - len(survivors)} of {len(chosen)} mutants died ({share:.0%}, at least {AT_LEAST:.0%})")
    return int(share < AT_LEAST)


# Drawing.


def changes(source: str) -> Iterator[tuple[str, ast.AST, str]]:
    """Yield what can be broken in a source: kind, the node and its replacement."""
    for node in ast.walk(ast.parse(source)):
        text = ast.get_source_segment(source, node) if isinstance(node, ast.expr) else None
        if text is None or "\n" in text:
            continue
        if isinstance(node, ast.Compare) and len(node.ops) == 1:
            right = ast.get_source_segment(source, node.comparators[0]) or ""
            left = ast.get_source_segment(source, node.left) or ""
            sign = text[len(left) : len(text) - len(right)].strip()
            if sign in NEGATED:
                yield from (("comparison", node, new) for new in (f"{left} {NEGATED[sign]} {right}", "True", "False"))
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not) and isinstance(node.operand, ast.Compare):
            inner = node.operand  # true for NaN; its twin is not
            sides = [ast.get_source_segment(source, side) or "" for side in (inner.left, *inner.comparators)]
            signs = re.findall(r" ([<>]=?) ", text)
            if len(signs) == len(sides) - 1:
                pairs = zip(sides, signs, sides[1:], strict=False)
                yield "nan", node, "(" + " or ".join(f"{one} {NEGATED[sign]} {two}" for one, sign, two in pairs) + ")"
        elif isinstance(node, ast.Attribute) and text in UNCHECKED:
            yield "nan", node, UNCHECKED[text]
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
            yield "constant", node, repr(node.value + 1 if isinstance(node.value, int) else node.value * 2 or 1.0)


def draw(seed: int, count: int) -> None:
    """Print mutants: for each a file is drawn, then one of its kinds of change, then the change."""
    dice = random.Random(seed)
    files = [ROOT / f"deltacharger_{folder}{name}.py" for folder, names in SAFETY.items() for name in names.split()]
    drawn: set[str] = set()
    while len(drawn) < count:
        path = dice.choice(files)
        source = path.read_text()
        found = list(changes(source))
        if not found:
            continue
        kind = dice.choice(sorted({kind for kind, _, _ in found}))
        _, node, new = dice.choice([one for one in found if one[0] == kind])
        lines = source.encode().splitlines(keepends=True)
        start, line = node.lineno - 1, lines[node.lineno - 1]
        old = line[node.col_offset : node.end_col_offset].decode()
        whole = (line[: node.col_offset] + new.encode() + line[node.end_col_offset :]).decode()
        text = line.decode()
        while source.count(text.strip()) > 1:
            start -= 1
            text, whole = lines[start].decode() + text, lines[start].decode() + whole
        name = f"{path.stem} {node.lineno}: {old} → {new}"
        if name not in drawn:
            drawn.add(name)
            rows = {"name": name, "file": str(path.relative_to(ROOT)), "text": text.strip(), "becomes": whole.strip()}
            for key, value in rows.items():
                print(f"{'- ' if key == 'name' else '  '}{key}: {json.dumps(value, ensure_ascii=False)}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    running = commands.add_parser("run")
    running.add_argument("words", nargs="*", metavar="NAME")
    running.add_argument("--marks", default="not rest and not night", help="which tests may kill")
    drawing = commands.add_parser("draw")
    drawing.add_argument("--seed", type=int, default=48)
    drawing.add_argument("--count", type=int, default=50)
    given = parser.parse_args()
    if given.command == "run":
        return run(given.words, given.marks)
    draw(given.seed, given.count)
    return 0


if __name__ == "__main__":
    sys.exit(main())
