# SPDX-License-Identifier: Apache-2.0
"""Checks of the board: greeting, complete frames from live taxels, power stage.

It starts and stops the stream and makes one probe (≤ 5 V, ≤ 50 mA). It sends no tare or heartbeat, and only on request
a command to the contactor: to clear a weld.
"""

import math
import statistics
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from deltacharger_bringup.doctor.findings import Finding, failed, hint, ok, wrong
from deltacharger_core.machine import BATTERY_MAX, BATTERY_MIN, BAUD_RATE, CONTACT_FORCE, Port, port_of
from deltacharger_driver import errors, port_identity
from deltacharger_driver.board import protocol
from deltacharger_driver.board.link import BoardLink
from deltacharger_tactile.estimator import Limits

WATCHED = 2.0  # s of stream
_RATE_SHARE = 0.95  # of the board's nominal rate; a lower rate is wrong
_LOST_SHARE = 0.01  # of frames; more lost frames mean a bad link
_PINGS = 20
_BRIDGED = "if nothing is docked, remove what bridges the electrodes"
_CABLE_ADVICE = "check plugs and cables; close other busy programs"


def examine_board(
    path: str, watched: float = WATCHED, wired: bool = False, clear_weld: bool = False
) -> Iterator[Finding]:
    """Greet the board on a port, watch its stream, read its power stage, probe once.

    Args:
        path: of the port; no other program may have it open.
        watched: s of stream.
        wired: the electrodes are wired to the battery (power: none): no power stage and no probe.
        clear_weld: clear a latched weld, if nothing is live.
    """
    frames: list[protocol.TactileSample] = []
    powers: list[protocol.PowerSample] = []
    link = BoardLink(path, on_tactile=frames.append, on_power=powers.append)
    try:
        hello = link.open()
    except protocol.BoardMismatch as error:
        yield failed("board", error, "flash the firmware of this version, or give the right port")
        return
    except errors.NoAnswer as error:
        if port_identity.identify(path, (BAUD_RATE, 57600)).kind == "servos":
            advice = "exchange the two cables, or the two ports in the scene or on the command line"
            yield wrong("board", f"{path}: the servos are here, not the board", advice)
        else:
            yield failed("board", error, "check the board's supply, both lines of its cable, and its firmware")
        return
    try:
        yield from _firmware(link, hello)
        yield from _stream(link, hello, frames, watched)
        if clear_weld:
            yield _clear_weld(link, powers)
        if wired:
            yield _wired(powers)
        else:
            yield _stage(hello)
            yield from _power(powers)
            yield _probe(link)
    finally:
        link.close()


def _firmware(link: BoardLink, hello: protocol.Hello) -> Iterator[Finding]:
    trip = statistics.median(link.ping() for _ in range(_PINGS))
    text = f"version {hello.major}.{hello.minor}, {hello.rows} x {hello.columns} taxels per pad, {hello.rate:g} Hz"
    yield ok("board", f"{text}; answers in {trip * 1e3:.1f} ms")
    if trip > protocol.HEARTBEAT_PERIOD:
        period = protocol.HEARTBEAT_PERIOD * 1e3
        slow = f"it takes {trip * 1e3:.0f} ms to answer; heartbeats are sent every {period:.0f} ms"
        yield hint("board", slow, "find what delays bytes: an adapter's latency timer, a hub, a busy computer")


def _stream(link: BoardLink, hello: protocol.Hello, frames: list[Any], watched: float) -> Iterator[Finding]:
    before, damaged = link.counters, link.decoder_counters.damaged
    link.start()
    began = time.monotonic()
    while time.monotonic() - began < watched and link.gone is None:
        time.sleep(0.05)
    link.stop()
    lost = link.counters.lost_tactile - before.lost_tactile
    damaged = link.decoder_counters.damaged - damaged
    if len(frames) < 2:
        text = f"{len(frames)} frames in {watched:g} s after the start of the stream"
        yield wrong("tactile link", text, "restart the board; if that does not help, flash its firmware again")
        return
    span = frames[-1].time - frames[0].time
    rate = (frames[-1].sequence - frames[0].sequence) / span if span > 0.0 else math.inf
    text = f"{rate:.1f} Hz of {hello.rate:g}, {lost} of {len(frames) + lost} frames lost, {damaged} damaged packets"
    if lost > _LOST_SHARE * len(frames) or rate < _RATE_SHARE * hello.rate:
        yield wrong("tactile link", text, _CABLE_ADVICE)
    elif lost or damaged:
        yield hint("tactile link", text, _CABLE_ADVICE)
    else:
        yield ok("tactile link", text)
    yield from _pads(frames)


def _pads(frames: list[Any]) -> Iterator[Finding]:
    """Yield dead taxels, force on a pad, and whether the pads are tared."""
    limit = Limits().pad_dead
    tared = bool(frames[-1].tared)
    for side, name in enumerate(("left", "right")):
        part = f"{name} pad"
        forces = np.stack([frame.pads[side] for frame in frames])
        dead = [(int(row), int(column)) for row, column in np.argwhere(np.isnan(forces).any(axis=0))]
        live = forces[:, ~np.isnan(forces).any(axis=0)]
        if dead:
            shown = ", ".join(f"row {row} column {column}" for row, column in dead[:6])
            text = f"{len(dead)} of {forces[0].size} taxels dead: {shown}{' ...' if len(dead) > 6 else ''}"
            if len(dead) > limit:
                yield wrong(
                    part, f"{text}; misalignment needs at most {limit}", "check the pad's plug; replace the pad"
                )
            else:
                yield hint(part, text, "the estimate interpolates them")
        else:
            yield ok(part, f"all {forces[0].size} taxels live")
        strongest = float(live.max()) if live.size else math.nan
        if tared and strongest >= CONTACT_FORCE:
            yield hint(part, f"up to {strongest:.1f} N on a taxel", "free the pad; else a tare is refused")
    yield ok(
        "tare", "done since the board's start" if tared else "not done since the board's start; each docking tares"
    )


def _clear_weld(link: BoardLink, powers: list[Any]) -> Finding:
    try:
        link.clear_weld()
    except (protocol.CommandRefused, errors.NoAnswer) as error:
        live = protocol.weld_problem(powers[-1].power) if powers else ""
        return failed("weld", error, f"{live}: undock and switch the battery off" if live else "")
    time.sleep(2.0 / protocol.POWER_RATE)  # the next report is without it
    return ok("weld", "none is latched")


def _power(powers: list[Any]) -> Iterator[Finding]:
    if not powers:
        yield wrong(
            "power", "no data from the power stage (20 per second expected)", "flash the board's firmware again"
        )
        return
    power = powers[-1].power
    if power.fault:
        yield wrong("power", f"fault latched: {protocol.fault_name(power.fault)}", protocol.clearing(power.fault))
    if power.contactor_closed:
        advice = "switch the battery off: without a heartbeat it must be open; the contactor may be welded"
        yield wrong("power", "the contactor reports closed without a command", advice)
    if math.isnan(power.battery_voltage):
        yield hint(
            "power",
            "battery voltage is not measured: with a contactor (power: board) docking does not energise",
            "check the power stage's plug and the voltage divider; for electrodes wired to the battery: power none",
        )
    elif not BATTERY_MIN <= power.battery_voltage <= BATTERY_MAX:
        text = f"battery {power.battery_voltage:.1f} V, outside {BATTERY_MIN} to {BATTERY_MAX} V"
        yield wrong("power", text, "charge or check it, check the voltage divider; docking does not energise")
    else:
        yield ok("power", f"battery {power.battery_voltage:.1f} V")


def _wired(powers: list[Any]) -> Finding:
    """Return the finding for electrodes wired to the battery; a working power stage contradicts that."""
    power = powers[-1].power if powers else None
    if power is None or not (power.contactor_closed or math.isfinite(power.battery_voltage)):
        text = "power: none: wired to the battery, live at every contact; nothing measures or interrupts the current"
        return hint("power", text, "fit a fuse and a switch close to the battery")
    text = f"docking_node has power: none, but the board has a power stage: battery {power.battery_voltage:.1f} V"
    return wrong("power", text, "set docking_node's power to board, to use contactor and probe")


def _stage(hello: protocol.Hello) -> Finding:
    """Return what the board declares of its stage; compare it with the converter's label."""
    way = "charges above its battery's voltage" if hello.steps_up else "only steps down"
    constant = "the board sets its voltage" if math.isnan(hello.stage_voltage) else f"{hello.stage_voltage:.1f} V"
    return ok("stage", f"{way}; {constant}")


def _probe(link: BoardLink) -> Finding:
    try:
        result = link.probe()
    except (protocol.CommandRefused, errors.NoAnswer) as error:
        return failed("probe", error, "clear the fault and open the contactor; else check the power stage's plug")
    port = port_of(result.resistance, result.target_voltage)
    if port is Port.OPEN:
        return ok("probe", "no current flows: nothing touches the electrodes, or a target is off or asleep")
    if port is Port.LIVE:
        text = f"{result.target_voltage:.1f} V between the electrodes: a target is connected"
        return hint("probe", text, "undock before you work on it")
    if port is Port.DEAD:
        text = f"{result.resistance:.3g} ohm without voltage between the electrodes: a target that is off or asleep"
        return hint("probe", text, _BRIDGED)
    remedies = {
        Port.SHORT: _BRIDGED,
        Port.REVERSED: "swap the terminals of the target, or of the board's probe",
        Port.UNKNOWN: "check the power stage's plug",
    }
    return wrong("probe", protocol.probe_problem(result.resistance, result.target_voltage), remedies[port])
