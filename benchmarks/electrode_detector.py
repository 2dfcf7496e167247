# SPDX-License-Identifier: Apache-2.0
"""How well the electrode detector does on simulated images, row by row: `python benchmarks/electrode_detector.py`.

The rows are those of `deltacharger report vision`, with other seeds; for a look at one of them while something is
changed. Tuning uses seeds below 1000, the report those from 20 000 on. "ms" is the processor time of an image together
with its detection; the detection's own stands in the report.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from deltacharger_lab.reports.vision.conditions import key
from deltacharger_lab.reports.vision.measure import judge
from deltacharger_lab.reports.vision.plan import plan
from deltacharger_lab.reports.vision.summary import row

FIRST_SEED = 10_000
ERRORS = "  ".join(f"{name:^11}" for name in ("xy mm", "z mm", "roll °"))
HEAD = f"{'':46}{'n':>5} {'found %':>8} {'wrong %':>8}  {ERRORS}  {'NEES':>6}  {'ms':>5}"


def line(name: str, found: dict[str, float], took: float) -> str:
    shares = (100.0 * found[part] / found["images"] for part in ("found", "wrong"))
    errors = (f"{found[f'{part}_p50']:5.2f} {found[f'{part}_p95']:5.2f}" for part in ("xy_mm", "z_mm", "roll_deg"))
    tail = "" if np.isnan(found["nees"]) else f"  {'  '.join(errors)}  {found['nees']:6.2f}  {1e3 * took:5.1f}"
    return f"{name:46}{found['images']:5d} {' '.join(f'{share:8.1f}' for share in shares)}{tail}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=40, help="images per row (default %(default)s)")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED, help="default %(default)s")
    parser.add_argument("--only", default="", help="rows whose name holds this")
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.frames)
    print(HEAD)
    for name in (key(each) for each in plan(None, 0, quick=True).conditions() if arguments.only in key(each)):
        started = time.process_time()
        _, images = judge(name, seeds)
        print(line(name, row(images), (time.process_time() - started) / len(seeds)), flush=True)


if __name__ == "__main__":
    main()
