# SPDX-License-Identifier: Apache-2.0
"""All hand-written files follow the same rules: a repeated key is refused by file and line, 1e-3 is a number."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.scenes.scene import load_scene
from deltacharger_core.yaml_file import YamlError, read_yaml, write_yaml
from deltacharger_kinematics.geometry import load_geometry
from deltacharger_vision import image_files, terminal

READERS: dict[str, Callable[[Path], Any]] = {
    "geometry": load_geometry,
    "scene": load_scene,
    "camera": image_files.load_camera_info,
}


@pytest.mark.parametrize("reader", READERS)
def test_every_reader_refuses_with_file_and_line(tmp_path: Path, reader: str) -> None:
    path = tmp_path / "written.yaml"
    for text, problem in (
        ("a: 1\nb: {c: 1}\na: 2\n", "line 3, column 1: the key 'a' is given twice"),
        ("1: a\n", "line 1, column 1: the key 1 is not text"),
        ("a: [", "YAML: line"),
        ("a: !!timestamp 2026-02-01", "line 1, column 4: could not determine a constructor for the tag"),
        ("a: &b [1]\nc: *b\n", "line 2, column 4: an alias"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=re.escape(problem)) as caught:
            READERS[reader](path)
        assert str(path) in str(caught.value)


def test_numbers_as_people_write_them_in_one_document(tmp_path: Path) -> None:
    path = tmp_path / "bars.yaml"
    path.write_text("{gap: 7e-3, bar_height: 1E-2}", encoding="utf-8")
    assert (terminal.Terminal.load(path).gap, terminal.Terminal.load(path).bar_height) == (0.007, 0.01)
    path.write_text("[1e5, -1e-3, +2.5e+1, 1_0e2, 1e, e5, '1e5']\n---\na: 2\n", encoding="utf-8")
    assert read_yaml(path, first=True) == [1e5, -1e-3, 25.0, 1000.0, "1e", "e5", "1e5"]
    with pytest.raises(YamlError, match="several documents"):
        read_yaml(path)


def test_written_yaml_is_read_back(tmp_path: Path) -> None:
    content = {"z": 1e-7, "a": [1.0, 2.0], "limbs": [{}, {"azimuth": 0.1}], "text": "yes"}
    write_yaml(tmp_path / "out.yaml", content, "two\nlines")
    assert (tmp_path / "out.yaml").read_text(encoding="utf-8").startswith("# two\n# lines\nz: ")
    assert read_yaml(tmp_path / "out.yaml") == content
    assert [path.name for path in tmp_path.iterdir()] == ["out.yaml"]
