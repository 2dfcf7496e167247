# SPDX-License-Identifier: Apache-2.0
"""`deltacharger view`: the Rerun file shows the recording's content; only this computer gets the page of `--web`."""

from __future__ import annotations

import contextlib
import math
import signal
import socket
import urllib.request
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest
from numpy.typing import NDArray

from deltacharger_bringup.cli.main import main
from deltacharger_docking.codes import State

from ..chargers import Process, new_namespace, wait_until
from .docking_tapes import docking, readings, state, write

pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(find_spec("rerun") is None, reason="`deltacharger view` needs deltacharger[view]"),
]

pytest.importorskip("mcap", reason="recordings need deltacharger[record]")


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Return the output of `view --recording` for a docking that charges for a second, with 100 samples."""
    path = tmp_path_factory.mktemp("docking") / "docking.rrd"
    charging = state(3.0, State.CHARGING, charging=True, docked=True)
    tape = write(path.with_suffix(".mcap"), docking(charging, *readings(3.0, 4.0, 5.0, rate=100.0)))
    assert main(["view", "--recording", str(tape), "--save", str(path)]) == 0
    return Recording(path)


class Recording:
    """A Rerun file: rows of each entity in the order of the timeline `run`."""

    def __init__(self, path: Path) -> None:
        import pyarrow
        import rerun as rr

        self._rows: dict[str, list[dict[str, Any]]] = {}
        for chunk in rr.chunk.RrdReader(str(path)).stream().to_chunks():
            batch = chunk.to_record_batch()
            for index, field in enumerate(batch.schema):
                if pyarrow.types.is_temporal(field.type):  # without pandas, nanoseconds have no Python value
                    batch = batch.set_column(index, field.name, batch.column(index).cast("int64"))
            self._rows.setdefault(str(chunk.entity_path).strip("/"), []).extend(batch.to_pylist())
        self.entities = set(self._rows)

    def rows(self, entity: str, component: str) -> list[tuple[float, Any]]:
        """Return (s of `run`, value) of an entity's component; static values have the time NaN."""
        found = []
        for row in self._rows.get(entity, []):
            if row.get(component) is not None:
                found.append((1e-9 * row["run"] if "run" in row else math.nan, row[component]))
        return sorted(found, key=lambda row: row[0])

    def scalars(self, entity: str) -> NDArray[np.float64]:
        """Return (n, 1 + values) of a plot: s, then its values."""
        return np.array([(time, *values) for time, values in self.rows(entity, "Scalars:scalars")])


def test_all_data_of_a_docking_are_shown(shown: Recording) -> None:
    expected = {"charger/arms", "charger/platform", "charger/base", "charger/target/given/terminal", "pads/left", "log"}
    expected |= {f"plots/{name}" for name in ("height", "contact/band", "servos", "angle", "pads", "charge/voltages")}
    assert expected - shown.entities == set()
    assert not {entity for entity in shown.entities if entity.startswith("camera/")}  # no data, no entity


def test_fast_topics_are_thinned_and_slow_ones_and_states_are_complete(shown: Recording) -> None:
    assert 60 < len(shown.scalars("plots/contact/measured")) <= 75 + 32
    assert len(shown.scalars("plots/pads")) <= 75 + 32
    assert len(shown.scalars("plots/charge/current")) == (75 + 100) / 5
    assert any("accepted" in text[0] for _, text in shown.rows("log", "TextLog:text"))
    np.testing.assert_array_equal(np.unique(shown.scalars("plots/contact/band")[:, 1:], axis=0), [[0.4, 0.5]])
    assert shown.scalars("plots/contact/reported")[-1, 1] == pytest.approx(0.45)

    states = [state[0] for _, state in shown.rows("state/1_docking", "StateChange:state")]
    assert states == ["idle", "approach", "contact", "measure", "charging"]
    assert [state[0] for _, state in shown.rows("state/3_contactor", "StateChange:state")] == ["open", "closed"]
    assert shown.scalars("plots/energy")[-1, 1] > 0.0


@pytest.fixture
def port() -> int:
    """Return a port that is free together with the next one."""
    for candidate in range(20000, 30000, 2):
        with (
            contextlib.suppress(OSError),
            socket.create_server(("", candidate)),
            socket.create_server(("", candidate + 1)),
        ):
            break
    return candidate


def _serves(port: int, host: str = "127.0.0.1") -> bool:
    with contextlib.suppress(OSError), socket.create_connection((host, port), timeout=5.0):
        return True
    return False


@pytest.mark.rest
def test_the_page_is_served_only_on_this_computer_until_the_end(
    start: Callable[..., Process], deltacharger: tuple[str, ...], port: int
) -> None:
    namespace = new_namespace()
    process = start(*deltacharger, "view", "--namespace", namespace, "--web", f"127.0.0.1:{port}")
    process.wait_for_line("open http", process.err)
    page = next(line for line in process.err if "open http" in line).split()[-1]
    with urllib.request.urlopen(page, timeout=10.0) as answer:
        assert b"rerun" in answer.read().lower()
    assert unquote(page).endswith(f"127.0.0.1:{port}/?url=rerun+http://127.0.0.1:{port + 1}/proxy")
    assert [_serves(each, host) for host in ("127.0.0.1", "127.0.0.2") for each in (port, port + 1)] == [
        *(True, True, False, False)
    ]
    process.wait_for_line("no messages for 5 s", process.err)
    silent = next(line for line in process.err if "no messages for" in line)
    names = ("servo_state", "tactile_frame", "charger_power", "docking_state")
    assert [name for name in names if f"/{namespace}/{name}" not in silent] == []
    assert process.end(signal.SIGINT) == 130
    wait_until(lambda: not _serves(port) and not _serves(port + 1), "both ports closed")
