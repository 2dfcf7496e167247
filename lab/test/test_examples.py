# SPDX-License-Identifier: Apache-2.0
"""Every file in lab/examples/ runs unchanged and prints what its docstring promises."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.mark.rest
def test_a_model_is_trained_judged_and_written(tmp_path: Path) -> None:
    pytest.importorskip("sklearn", reason="trains with deltacharger-lab[train]")
    words = (sys.executable, str(EXAMPLES / "train_a_model.py"), str(tmp_path / "model.npz"))
    run = subprocess.run(words, capture_output=True, text=True, timeout=110.0, cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    promised = r"on 825 others.*accuracy [89]\d\.\d %;.* class 2\d.*may be acted on"
    assert re.search(promised, run.stdout, re.DOTALL), run.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["model.npz"]
