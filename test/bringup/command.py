# SPDX-License-Identifier: Apache-2.0
"""The command `deltacharger`, run in this process."""

from __future__ import annotations

import pytest

from deltacharger_bringup.cli.main import main


def run(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    """Return exit code, standard output and standard error."""
    try:
        code = main(list(map(str, words)))
    except SystemExit as end:  # argparse ends the process itself
        code = int(end.code or 0)
    return code, *capsys.readouterr()
