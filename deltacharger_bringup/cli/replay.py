# SPDX-License-Identifier: Apache-2.0
"""`deltacharger replay`: explain and draw a recorded docking, or list the records of a folder."""

import argparse
import math
import time
from pathlib import Path
from typing import Any

from deltacharger_bringup.cli import arguments, output
from deltacharger_bringup.records.recording.folder import ABOUT, END, PARTIAL
from deltacharger_core import environment, streams
from deltacharger_core.mcap_file import BAGS, McapFile, RecordingError

_STATE = "deltacharger/msg/DockingState"


def add_replay(parser: argparse.ArgumentParser) -> None:
    """Add the options of `replay`."""
    parser.add_argument("path", metavar="FILE|DIR", help="record (also an incomplete one), or folder of records")
    parser.add_argument("--picture", metavar="FILE", help="draw the record: .png, .pdf, .svg or .jpg")
    arguments.namespace_option(parser)


def replay(options: argparse.Namespace) -> output.Result:
    """Explain one record and draw it on request, or list the records of a folder."""
    environment.prepare()
    path = Path(options.path)
    with output.wrong_input(RecordingError):
        return _folder(options, path) if path.is_dir() else _file(options, path)


def _file(options: argparse.Namespace, path: Path) -> output.Result:
    try:
        from deltacharger_bringup.records.replay.record import replay as read
        from deltacharger_bringup.records.replay.words import story, why
    except ImportError as error:
        raise output.CommandError(
            f"ROS 2 or the built interfaces are missing ({error}): install the package"
        ) from error

    picture = arguments.picture_to_write(options.picture) if options.picture else None
    found = read(path, options.namespace)
    lines, closing = story(found), why(found)
    if picture is not None:
        from deltacharger_bringup.records.replay.picture import PictureError, draw

        scene = found.about.get("scene", "")
        about = (_when(found.began_ns), found.request_id, f"scene {scene}" if scene else "")
        try:
            draw(found, picture, "   ·   ".join(filter(None, about)))
        except PictureError as error:
            raise output.CommandError(f"no picture: {error}") from error
        output.log_line(f"picture: {picture}")
    head = [f"{_when(found.began_ns)}  {streams.plain(found.request_id) or 'no request id'}  {found.outcome()['name']}"]
    if found.damage:
        head.append(f"incomplete: {found.damage}")
    details = {"story": lines, "why": closing, "picture": str(picture) if picture else None}
    return output.Result("\n".join([*head, *lines, "", closing]), {**found.as_dict(), **details})


def _folder(options: argparse.Namespace, folder: Path) -> output.Result:
    if options.picture:
        raise output.CommandError("--picture draws one record; give a file, not a folder", output.WRONG_INPUT)
    names = sorted(path for path in folder.iterdir() if path.name.endswith((*BAGS, PARTIAL)))
    entries = [_entry(path) for path in names if not path.name.startswith(".")]
    lines = []
    for entry in entries:
        name = streams.plain(entry["file"])
        if entry["problem"]:
            lines.append(f"{name}: {streams.plain(entry['problem'])}")
            continue
        size = entry["bytes"] / 1e6
        lines.append(
            f"{_when(round(entry['time'] * 1e9))}  {entry['duration']:9.1f} s  {size:7.2f} MB  "
            f"{entry['outcome'] or '–':<22} {streams.plain(entry['request_id']) or '–'}  ({name})"
        )
    details = {"folder": str(folder), "records": entries}
    return output.Result("\n".join(lines), details, remarks=() if entries else [f"{folder}: no records"])


def _entry(path: Path) -> dict[str, Any]:
    entry: dict[str, Any] = {"file": path.name, "bytes": 0, "problem": ""}
    nothing = {"time": math.nan, "duration": math.nan, "outcome": "", "request_id": ""}
    try:
        entry["bytes"] = path.stat().st_size
        file = McapFile(path)
        states = [topic for topic, kind in file.types.items() if kind == _STATE]
        if not any(file.counts[topic] for topic in states):
            raise RecordingError("it holds no docking_state, so it is no record of a docking")
    except (RecordingError, OSError) as error:
        return entry | {"problem": str(error)} | nothing
    about, end = (file.metadata_named(name) or [{}] for name in (ABOUT, END))
    return entry | {
        "time": file.first * 1e-9,
        "duration": (file.last - file.first) * 1e-9,
        "outcome": end[-1].get("ending", "unfinished" if about[-1] else ""),
        "request_id": about[-1].get("request_id", ""),
    }


def _when(ns: int) -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(ns * 1e-9))
