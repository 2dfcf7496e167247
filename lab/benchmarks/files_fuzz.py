# SPDX-License-Identifier: Apache-2.0
"""Robustness of file readers: `python lab/benchmarks/files_fuzz.py [--files 1000000] [--json]`.

Good files of every kind, from our own writers, are changed at random and read. Exit code 1 if a law is violated: only
named refusals, at most 2 s of CPU and 200 MB more memory per file, no invalid file accepted. A number determines each
file: `--kind KIND --first NUMBER --files 1` repeats it. A million per kind take hours; `--processes` shares them.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeAlias

Case: TypeAlias = tuple[int, str, Callable[[Path], Any]]  # index of the reader, name, creator of the file
KINDS = ("yaml", "csv", "npz", "npy", "picture", "mcap", "json", "parquet")
SECONDS, MEGABYTES, STUCK = 2.0, 200.0, 30
LONGEST_MESSAGE = 3000
MOST_SHOWN = 20
NOTHING = {"files": 0, "taken": 0, "refused": 0, "seconds": 0.0, "megabytes": 0.0}
MAY_BE_TAKEN = ("two documents", "a chunk in a chunk", "metadata without end", "a summary that is everywhere")
"""Attacks that a reader may accept, because data before the damage are good: an echoed topic, a recording."""


def peak() -> float:
    """Return the peak memory of this process, MB."""
    text = Path("/proc/self/status").read_text()
    return int(text[text.index("VmHWM:") + 6 :].split(None, 1)[0]) / 1024


def reset_peak() -> None:
    """Reset `peak`; if the kernel does not allow it, memory is judged by the largest value so far."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def judge(reader: Any, path: Path, before: float) -> tuple[str, str]:
    """Read a file; return "taken" or "refused", and the violated law, '' = none."""
    outcome, broken, started = "taken", "", time.process_time()
    signal.alarm(STUCK)
    try:
        found = reader.read(path)
    except reader.refusals as error:
        outcome, text = "refused", str(error)
        named = not reader.names or path.name in text or str(path.parent) in text
        if not text or len(text) > LONGEST_MESSAGE or not named:
            broken = f"a refusal of {len(text)} characters: {text[:300]}"
    except Exception as error:
        broken = f"{type(error).__name__}: {str(error)[:300]}\n{''.join(traceback.format_exception(error)[-3:])}"
    else:
        try:
            reader.sound(found)
        except Exception as error:
            broken = f"false accept: {type(error).__name__}: {str(error)[:300]} {traceback.format_exc(limit=-1)}"
    signal.alarm(0)
    took, more = time.process_time() - started, peak() - before
    if took > SECONDS:
        broken = broken or f"took {took:.1f} s"
    if more > MEGABYTES:
        broken = broken or f"took {more:.0f} MB more"
    return outcome, broken


def changed(known: Sequence[Any], given: argparse.Namespace) -> Iterator[Case]:
    """Yield good files with random changes."""
    from fuzz_mutations import mutated

    for number in range(given.first, given.first + given.files):
        which = number % len(known)
        data = mutated(f"{given.kind} {given.seed} {number}", known[which].good, known[which].changes)
        yield which, str(number), lambda path, data=data: path.write_bytes(data)


def attacking(known: Sequence[Any], given: argparse.Namespace) -> Iterator[Case]:
    """Yield every attack for each reader."""
    from fuzz_attacks import attacks

    for which in range(len(known)):
        for name, put in attacks(given.kind).items():
            yield which, name, put


def work(given: argparse.Namespace, beat: int) -> dict[str, Any]:
    """Read the files of one worker in this process."""
    from fuzz_files import readers

    warnings.simplefilter("ignore")
    report: dict[str, Any] = dict(NOTHING, broken=[])
    with tempfile.TemporaryDirectory() as made, tempfile.TemporaryDirectory() as folder:
        known = readers(Path(made), given.kind)
        places = [Path(folder) / str(which) / reader.place for which, reader in enumerate(known)]
        for which, (reader, place) in enumerate(zip(known, places, strict=True)):
            place.parent.mkdir(parents=True)
            for name, content in reader.beside.items():
                (Path(folder) / str(which) / name).write_bytes(content)
            for good in reader.good:  # this also loads modules that are loaded once
                place.write_bytes(good)
                reader.sound(reader.read(place))
        before = peak()
        for which, name, put in (attacking if given.attacks else changed)(known, given):
            reader, place = known[which], places[which]
            remove(place)
            put(place)
            os.pwrite(beat, f"{reader.name}: {name}".encode().ljust(200), 0)
            if given.attacks:
                reset_peak()
                before = peak()
            begun = time.process_time()
            outcome, broken = judge(reader, place, before)
            report["files"] += 1
            report[outcome] += 1
            report["seconds"] = max(report["seconds"], time.process_time() - begun)
            report["megabytes"] = max(report["megabytes"], peak() - before)
            if given.attacks and outcome == "taken" and name not in MAY_BE_TAKEN:
                broken = broken or "taken"
            if broken:
                reset_peak()
                report["broken"].append(f"{reader.name}, {given.kind} {name}: {broken}")
                if len(report["broken"]) >= MOST_SHOWN:
                    break
    return report


def remove(path: Path) -> None:
    """Remove a file, folder or link."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def start(kind: str, first: int, count: int, arguments: argparse.Namespace, folder: Path) -> tuple[Any, Path, Path]:
    beat, out = folder / f"{kind}-{first}.beat", folder / f"{kind}-{first}.json"
    words = [sys.executable, __file__, "--kind", kind, "--first", first, "--files", count]
    words += ["--seed", arguments.seed, *["--attacks"] * arguments.attacks]
    log = (folder / f"{kind}-{first}.log").open("wb")
    process = subprocess.Popen([*map(str, words), "--beat", str(beat), "--out", str(out)], stdout=log, stderr=log)
    return process, beat, out


def finish(process: Any, beat: Path, out: Path, kind: str) -> dict[str, Any]:
    """Wait for a worker and return its report; for a crash the report names the file."""
    if process.wait() == 0:
        report: dict[str, Any] = json.loads(out.read_text())
        return report
    at = beat.read_text().strip() if beat.exists() else "the beginning"
    end = beat.with_suffix(".log").read_text(errors="replace")[-1500:]
    return dict(NOTHING, broken=[f"{kind} {at}: the process ended with {process.returncode}: {end}"])


def campaign(arguments: argparse.Namespace, folder: Path) -> dict[str, Any]:
    share = max(1, -(-arguments.files // arguments.processes))
    result: dict[str, Any] = {}
    for kind in [arguments.kind] if arguments.kind else KINDS:
        begun = time.monotonic()
        firsts = range(arguments.first, arguments.first + arguments.files, share)
        counts = [min(share, arguments.first + arguments.files - first) for first in firsts]
        workers = [start(kind, first, count, arguments, folder) for first, count in zip(firsts, counts, strict=True)]
        while arguments.progress and any(process.poll() is None for process, _, _ in workers):
            with contextlib.suppress(OSError, ValueError):
                done = sum(
                    int(beat.read_text().split()[-1]) - first
                    for (_, beat, _), first in zip(workers, firsts, strict=True)
                )
                print(f"\r{kind}: {done} of {arguments.files}", end="", file=sys.stderr, flush=True)
            time.sleep(1.0)
        report = [finish(*worker, kind) for worker in workers]
        total: dict[str, Any] = {key: sum(each[key] for each in report) for key in ("files", "taken", "refused")}
        total |= {key: round(max(each[key] for each in report), 3) for key in ("seconds", "megabytes")}
        total["per_second"] = round(total["files"] / max(time.monotonic() - begun, 1e-9))
        total["broken"] = [line for each in report for line in each["broken"]]
        result[kind] = total
        if arguments.progress:
            print(f"\r{kind}: {json.dumps({**total, 'broken': len(total['broken'])})}", file=sys.stderr)
    return result


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--files", type=int, default=1_000_000, help="files of each kind (default 1000000)")
    parser.add_argument("--kind", choices=KINDS, help="only this kind")
    parser.add_argument("--first", type=int, default=0, help="number of the first file")
    parser.add_argument(
        "--attacks", action="store_true", help="instead of random changes: lab/benchmarks/fuzz_attacks.py"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--progress", action="store_true", help="print progress on stderr")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of text")
    for hidden in ("--beat", "--out"):
        parser.add_argument(hidden, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.attacks:
        arguments.files = 1
    if arguments.out:  # a worker
        resource.setrlimit(resource.RLIMIT_AS, (8 * 2**30, 8 * 2**30))  # so that a bomb ends only this process
        beat = os.open(arguments.beat, os.O_WRONLY | os.O_CREAT, 0o600)
        Path(arguments.out).write_text(json.dumps(work(arguments, beat)))
        return 0
    with tempfile.TemporaryDirectory() as folder:
        result = campaign(arguments, Path(folder))
    if arguments.json:
        print(json.dumps(result))
    else:
        for kind, figures in result.items():
            print(f"{kind}: {json.dumps(figures, indent=2)}")
    return 1 if any(figures["broken"] for figures in result.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
