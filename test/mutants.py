# SPDX-License-Identifier: Apache-2.0
"""Breaks lines on which safety depends, one at a time, and shows which of them the quick tests notice (`make mutants`).

    python test/mutants.py [WORD…]    all mutants of mutants.yaml, or those whose names contain a word

Each mutant replaces a text, which stands once in its file (if that is gone: once in the product). In a copy of the tree
runs first the table of safety numbers, then the quick tests that mirror the broken module: those files of its package's
folder in test/ that import it, or the whole folder if none does.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import yaml

ROOT = Path(__file__).resolve().parents[1]
TABLE = "test/core/test_safety_numbers.py"
AT_LEAST = 0.9
QUICK = "not rest and not night"
PYTEST = [sys.executable, "-m", "pytest", "-xq", "--timeout=30", "-n", "2", "-p", "no:cacheprovider", "-m", QUICK]


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
        times = sum(path.read_text().count(self.text) for path in found)
        if times != 1:
            raise SystemExit(f"mutant '{self.name}': its text must stand once in the product, not {times} times")
        return found[0]

    def suites(self, tree: Path) -> list[list[str]]:
        """Return what to run, in turn: the table of safety numbers, then the tests that mirror its file."""
        package, *names = self.place(tree).relative_to(tree).with_suffix("").parts
        parent, module = ".".join((package, *names[:-1])), names[-1]
        imports = re.compile(rf"(import|from) {parent}\.{module}\b|from {parent} import .*\b{module}\b")
        folder = tree / package.replace("deltacharger_", "test/")
        near = [str(path) for path in sorted(folder.rglob("test_*.py")) if imports.search(path.read_text())]
        return [[TABLE], self.tests.split() or near or [str(folder)]]


def copy(folder: Path) -> Path:
    """Copy what git tracks or would track."""
    listed = ["git", "-C", ROOT, "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    for name in filter(None, subprocess.check_output(listed, text=True).split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def failure(tests: list[str], tree: Path) -> list[str]:
    """Return the first test that fails in a copy, or all if pytest ended without naming one; [] if none fails."""
    # The copy comes before the editable install in every process that a test starts, and it compiles its own files.
    env = {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1", "ROS_DOMAIN_ID": "90"}
    done = subprocess.run([*PYTEST, *tests], cwd=tree, env=os.environ | env, capture_output=True, text=True)
    found = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", done.stdout, re.MULTILINE)
    return [] if done.returncode in (0, 5) else [found[1]] if found else tests


def killer(mutant: Mutant, tree: Path) -> list[str]:
    """Return the first test that fails with this mutant, twice, and not without it; [] if none does."""
    path, suites = mutant.place(tree), mutant.suites(tree)
    whole = path.read_text()
    path.write_text(whole.replace(mutant.text, mutant.becomes))
    try:
        failed = next((failed for suite in suites if (failed := failure(suite, tree))), [])
        fails = failed and failure(failed, tree)
    finally:
        path.write_text(whole)
    return failed if fails and not failure(failed, tree) else []


def main(words: list[str]) -> int:
    every = [Mutant(**row) for row in yaml.safe_load((ROOT / "test/mutants.yaml").read_text())]
    chosen = [one for one in every if one.place(ROOT) and (not words or any(word in one.name for word in words))]
    if not chosen:
        raise SystemExit(f"no mutant's name contains {' or '.join(words)}")
    died = 0
    with tempfile.TemporaryDirectory() as folder:
        tree = copy(Path(folder))
        if failed := failure([TABLE], tree):
            raise SystemExit(f"{failed[0]} fails without a mutant")
        for mutant in chosen:
            died_by = killer(mutant, tree)
            died += bool(died_by)
            print(f"{'died    ' if died_by else 'SURVIVED'} {mutant.name:60.60} {' '.join(died_by)}", flush=True)
    print(f"{died} of {len(chosen)} mutants died; at least {AT_LEAST:.0%} must")
    return int(died < AT_LEAST * len(chosen))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
