# SPDX-License-Identifier: Apache-2.0
"""Readers of our own files: recordings, journals of data sets, results of campaigns."""

from __future__ import annotations

import contextlib
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fuzz_mutations as change
import numpy as np
from fuzz_reader import Reader, written

ROOT = Path(__file__).resolve().parents[2]


def of_recordings(folder: Path) -> Iterator[Reader]:
    from deltacharger_core import environment

    environment.prepare()
    sys.path.insert(0, str(ROOT / "test" / "records"))
    from docking_tapes import NAMES, RECORDED, docking, measured, refused, result, write
    from mcap.writer import CompressionType, Writer

    from deltacharger_core.mcap_file import McapFile, RecordingError
    from deltacharger_docking.codes import Code
    from deltacharger_records.datasets.dataset import Docking, Settings
    from deltacharger_records.datasets.journal import Journal
    from deltacharger_records.datasets.plan import Part
    from deltacharger_records.replay.record import replay

    tape = docking(measured(2.7, 12.5), *refused(Code.CRITICAL_ANGLE, "tilted", at=2.9), until=0.05)
    topics = {NAMES[name]: RECORDED[NAMES[name]] for name in ("docking_state", "docking_decision", "tactile_frame")}
    parameters = {"position_tolerance": 0.002, "geometry_file": "none.yaml"}
    end = result(Code.CRITICAL_ANGLE, "tilted")
    record = written(folder, "r.mcap", lambda path: write(path, tape, end, parameters=parameters, topics=topics))

    def plain(path: Path, **options: Any) -> None:
        """Write as other programs do: without checksums, so that damage stays undetected, with or without chunks."""
        with path.open("wb") as stream:
            writer = Writer(stream, chunk_size=2000, enable_crcs=False, **options)
            writer.start(profile="ros2", library="others")
            for name, values in McapFile(folder / "r.mcap").metadata:
                writer.add_metadata(name, values)
            file = McapFile(folder / "r.mcap")
            channels = {}
            for topic in topics:
                schema = writer.register_schema(file.types[topic], "ros2msg", file.definitions[topic].encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            for each in file.messages():
                writer.add_message(channels[each.topic], each.received, each.data, each.published)
            writer.finish()

    ways = [{"use_chunking": False}, *({"compression": each} for each in (CompressionType.NONE, CompressionType.LZ4))]
    records = [record, *(written(folder, "o.mcap", lambda path, way=way: plain(path, **way)) for way in ways)]

    def look(path: Path) -> Any:
        file = McapFile(path)
        with contextlib.suppress(KeyError):  # no file of this name: all were searched
            file.attachment("")
        return file, sum(1 for _ in file.messages())

    def sound_look(found: Any) -> None:
        file, count = found
        assert 0 <= count <= 2**20
        assert all(isinstance(text, str) for text in (*file.types, *file.types.values(), *file.definitions.values()))
        assert all(type(value) is int and value >= 0 for value in (*file.counts.values(), file.first, file.last))

    def sound_replay(found: Any) -> None:
        json.dumps(found.as_dict())
        assert all(math.isfinite(phase.start) and phase.start <= phase.end for phase in found.phases)

    part, settings = Part("reference", 0.0, 10, 0, 0.0, 0.0, 80.0), Settings(1, "", 1, 2, 0.5, 0.5, False)
    frames = np.full((2, 2, 10, 10), 0.4, dtype=np.float32)
    with Journal(folder / "F.npz") as journal:
        for number in range(2):
            kept = Docking(number, 0, part.name, number, 0.0, 0.0, 0.0, 1e-4, -2e-4, 0.45, 1.8e9, frames)
            journal.store(kept, part, settings, {}, [])
    kept_files = {str(path.relative_to(folder)): path.read_bytes() for path in (folder / "F.recording").iterdir()}
    first, head = "F.recording/docking-000000.mcap", "F.recording/recording.json"

    def compose(path: Path) -> Any:
        (path.parent.parent / "F.npz").unlink(missing_ok=True)
        with Journal(path.parent.parent / "F.npz") as journal:
            journal.next_attempt, journal.next_session  # noqa: B018
            return journal.dockings

    def sound_dockings(found: Any) -> None:
        assert all(type(each.attempt) is int and isinstance(each.part, str) for each in found)
        assert all(each.frames.shape[1:] == (2, 10, 10) for each in found)

    refusals = RecordingError, OSError
    yield Reader("recording", "mcap", "a.mcap", records, look, refusals, sound_look, change.BYTES)
    yield Reader("replay", "mcap", "a.mcap", records, replay, refusals, sound_replay, change.BYTES)
    yield Reader(
        "journal", "mcap", first, [kept_files[first]], compose, refusals, sound_dockings, change.BYTES, kept_files
    )
    yield Reader(
        "journal_head", "json", head, [kept_files[head]], compose, refusals, sound_dockings, change.TEXT, kept_files
    )


def of_campaigns(folder: Path) -> Iterator[Reader]:
    import pyarrow
    import pyarrow.parquet

    from deltacharger_lab.campaigns.scene import load_campaign_scene
    from deltacharger_lab.campaigns.settings import CampaignError, CampaignSettings
    from deltacharger_lab.campaigns.store import SETTINGS, _schema, read_parts, read_settings

    pyarrow.set_cpu_count(1)
    content = dict(load_campaign_scene("random").content)
    settings = CampaignSettings(4, 3, False, content, "random", {"python": "3"})
    schema = _schema(settings)
    values = {pyarrow.int64(): 5, pyarrow.float64(): 0.5, pyarrow.bool_(): True, pyarrow.string(): "charged at once"}
    rows = [{item.name: values[item.type] for item in schema} | {"number": number} for number in range(4)]
    table = pyarrow.Table.from_pylist(rows, schema=schema).select(["number", "code", "code_name", "time", "charged"])
    parts = [
        written(folder, "part.parquet", lambda path, way=way: pyarrow.parquet.write_table(table, path, **way))
        for way in ({}, {"compression": "none"}, {"use_dictionary": False, "data_page_version": "2.0"})
    ]

    def columns(path: Path) -> Any:
        return list(read_parts(path.parent, table.column_names))

    def sound_columns(found: Any) -> None:
        for part in found:
            assert {len(column) for column in part.values()} == {len(part["number"])}
            assert all(type(number) is int and number >= 0 for number in part["number"])

    def sound_settings(found: Any) -> None:
        assert type(found.n) is int
        assert found.n >= 0

    def stored(path: Path) -> Any:
        return read_settings(path.parent)

    record, refusals = settings.to_json().encode(), (CampaignError, OSError)
    yield Reader("results", "parquet", "part-000000000.parquet", parts, columns, refusals, sound_columns, change.BYTES)
    yield Reader("settings", "json", SETTINGS, [record], stored, refusals, sound_settings, change.TEXT)
