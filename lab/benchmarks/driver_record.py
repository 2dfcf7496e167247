# SPDX-License-Identifier: Apache-2.0
"""Figures of a record of driver_long.py, with their targets."""

from typing import Any

import numpy as np
from driver_processes import DRIVER_LIMIT, CannotMeasure, Figure, at_most

LIMITS = (0.050, 0.060, 0.075, 0.095, 0.125, 0.150, 0.200, 0.250)  # s without a heartbeat; the board's is 0.095
INTENDED = 1.0  # s; a longer pause of the heartbeat follows an opening
LATE_BOARD = 0.010  # s; delay of the emulator within a gap, from which the gap is no measure of the host
TACTILE_RATE, SERVO_RATE = 120.0, 100.0  # Hz


def evaluate(record: dict[str, Any]) -> list[Figure]:
    """Return the figures of a record, with targets."""
    if len(record["frames"]) < 2 or len(record["states"]) < 2:
        raise CannotMeasure("the nodes published nothing")
    asked, seconds = record["asked"], record["seconds"]
    length = Figure("measured, from docked on", seconds, "s", f"{asked:.0f} s", bool(seconds >= asked))
    return [length, *_tactile(record), *_contactor(record), *_servos(record), *_processes(record)]


def _tactile(record: dict[str, Any]) -> list[Figure]:
    sequence, device, stamp = record["frames"].T
    number, due, taken = record["samples"].reshape(-1, 3).T
    number = np.unwrap(number, period=65536)
    order = np.searchsorted(number, sequence)
    if order[-1] >= len(number) or np.any(number[order] != sequence):
        raise CannotMeasure("frames without a sample of the emulator; did the board reboot?")
    start = due[order] - device * 1e-6  # boot time of the board, equal for all frames
    if np.ptp(start) > 5e-6:
        raise CannotMeasure(f"device times do not fit the sampling instants ({np.ptp(start):.1e} s)")
    rate = (len(stamp) - 1) / (stamp[-1] - stamp[0])
    lost = sequence[-1] - sequence[0] + 1 - len(sequence)
    skipped = number[order[-1]] - number[order[0]] - (order[-1] - order[0])
    late = taken[order[0] : order[-1] + 1] - due[order[0] : order[-1] + 1]
    return [
        Figure("tactile frames", rate, "Hz", "120.0 Hz", bool(abs(rate - TACTILE_RATE) < 0.05)),
        at_most(f"  of {len(sequence)}, lost", lost, "frames", 0),
        Figure("  of which the link counted, damaged or gone", record["counters"]["lost_tactile"], "frames"),
        Figure("  of which the emulator itself left out", skipped, "frames"),
        *_distribution("stamp from the sampling instant", np.abs(stamp - due[order]), 1e3, "ms", 1.0),
        Figure("  median with its sign, positive = late", 1e3 * float(np.median(stamp - due[order])), "ms"),
        *_distribution("emulator's own lateness in sampling", late, 1e3, "ms"),
    ]


def _distribution(what: str, values: Any, scale: float, unit: str, limit: float | None = None) -> list[Figure]:
    """Return median, 99th percentile (with `limit`) and maximum of values."""
    middle, high, top = (float(scale * value) for value in (*np.percentile(values, (50, 99)), np.max(values)))
    p99 = Figure(f"{what}, p99", high, unit) if limit is None else at_most(f"{what}, p99", high, unit, limit)
    return [Figure(f"{what}, p50", middle, unit), p99, Figure(f"{what}, largest", top, unit)]


def _contactor(record: dict[str, Any]) -> list[Figure]:
    from scipy.stats import chi2

    at, closed = record["beats"].reshape(-1, 2).T
    gaps, began = np.diff(at), at[:-1]
    lies = (began >= record["span"][0]) & (at[1:] <= record["span"][1]) & (closed[:-1] > 0) & (gaps < INTENDED)
    gaps, began = gaps[lies], began[lies]
    if not len(gaps):
        raise CannotMeasure("no heartbeat reached the board")
    hours = float(gaps.sum()) / 3600.0
    _, due, taken = record["samples"].reshape(-1, 3).T
    late = taken[taken - due > LATE_BOARD]
    starved = np.searchsorted(late, began + gaps, "right") > np.searchsorted(late, began)
    figures = [
        at_most(f"openings by themselves in {record['charged']:.0f} s of charging", len(record["openings"]), "", 0),
        *_distribution("gap between heartbeats at the board", gaps, 1e3, "ms"),
    ]
    for limit in LIMITS:
        over = gaps > limit
        bound = float(chi2.ppf(0.95, 2 * int(over.sum()) + 2)) / 2.0 / hours
        blame = f", {int((over & starved).sum())} while the emulator was late" if over.any() else ""
        what = f"  a limit of {1e3 * limit:.0f} ms: {int(over.sum())} openings{blame}"
        figures += [Figure(what, float(over.sum()) / hours, "/h", f"below {bound:.3g} /h")]
    return figures


def _servos(record: dict[str, Any]) -> list[Figure]:
    states = record["states"]
    rate = (len(states) - 1) / (states[-1] - states[0])
    return [
        Figure("servo states", rate, "Hz", "100.0 Hz", bool(abs(rate - SERVO_RATE) < 0.5)),
        Figure("  cycles that began more than half a period late", record["counters"]["late_cycles"], ""),
        Figure("  longest time between two states", 1e3 * float(np.diff(states).max()), "ms"),
    ]


def _processes(record: dict[str, Any]) -> list[Figure]:
    figures = []
    for name, percent in record["cpu_percent"].items():
        what = f"CPU of {name}"
        has_target = name in ("servo_node", "tactile_node")
        figures += [
            at_most(what, percent, "% of a core", DRIVER_LIMIT) if has_target else Figure(what, percent, "% of a core")
        ]
    return [*figures, Figure("load average over the last minute", record["load"], "")]
