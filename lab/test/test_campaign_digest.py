# SPDX-License-Identifier: Apache-2.0
"""A campaign continues only with the code that began it: every file that decides a docking changes the digest."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

from deltacharger_lab.campaigns import store
from test.marks import night, rest

RUN = """
import json, sys
from deltacharger_lab.campaigns.docking import dock_once, make_charger
from deltacharger_lab.campaigns.draw import draw
from deltacharger_lab.campaigns.scene import parse_campaign_scene
scene = parse_campaign_scene({"target": {"x": [-0.01, 0.01]}}, "x")
assert not dock_once(scene, 41, 0)["error"]
make_charger(draw(scene, 41, 0), exact=True)
print(json.dumps({n: m.__file__ for n, m in sys.modules.items() if n.startswith("deltacharger_")}))
"""
ONLY_READS = ("deltacharger_bringup.scenes", "deltacharger_vision")
"""Loaded without effect on the numbers of a row: paths of scenes, and what a scene sets of its camera."""


@pytest.mark.rest
def test_every_module_that_a_docking_loads_is_covered() -> None:
    ran = subprocess.run([sys.executable, "-c", RUN], stdout=subprocess.PIPE, text=True, check=True)
    loaded = {name: Path(file) for name, file in json.loads(ran.stdout).items()}
    assert len(loaded) > 50
    covered = {path for _, path in store.computing()}
    missing = {
        name
        for name, path in loaded.items()
        if path not in covered and not name.startswith(ONLY_READS) and len(ast.parse(path.read_text("utf-8")).body) > 1
    }
    assert not missing


@pytest.mark.parametrize("step", [rest(100), night(1)])
def test_an_edit_of_any_file_changes_the_digest(monkeypatch: pytest.MonkeyPatch, step: int) -> None:
    files = dict(store.computing())
    known = {path: store.meaning(path) for path in files.values()}
    edits, edited = list(files.values())[::step], list[Path]()
    monkeypatch.setattr(store, "meaning", lambda path: known[path] + (b"x" if path in edited else b""))
    first, found = store._digest(), set()
    for edited[:] in ([path] for path in edits):
        found.add(store._digest())
    assert len(found | {first}) == len(edits) + 1
    assert {name.partition("/")[0] for name in files} == {*store._COMPUTES, "config"}


def test_comments_and_docstrings_do_not_change_the_digest_and_numbers_do(tmp_path: Path) -> None:
    def meaning(text: str) -> bytes:
        (tmp_path / "module.py").write_text(text, "utf-8")
        return store.meaning(tmp_path / "module.py")

    plain = meaning("A = 1\ndef f():\n    return 'x'\n")
    assert (
        meaning('"""Words."""\nA = (1)  # a number\n"""More."""\ndef f():\n    """Say."""\n    return "x"\n') == plain
    )
    assert plain not in (meaning("A = 1\ndef f():\n    return 'y'\n"), meaning("A = 2\ndef f():\n    return 'x'\n"))
