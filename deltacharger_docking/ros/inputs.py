# SPDX-License-Identifier: Apache-2.0
"""Inputs of docking: the latest message of each topic as one observation; refusals. Part of docking_node."""

import math
import threading
import time
from collections import deque
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from deltacharger.msg import ChargerPower, ServoState, TactileFrame
from rclpy.clock import Clock
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from deltacharger_core import machine, real_time, texts
from deltacharger_core.ros import diagnostics, messages, on_demand
from deltacharger_core.ros.clock import ANOTHER_CLOCK, ClockWatch, age
from deltacharger_core.ros.log import Log
from deltacharger_docking.observation import Observation, Reply

_LOOK = 0.1  # s between checks for second sources; each takes 0.1 ms
_BACKLOG = 64  # tactile frames, half a second: frames are kept while docking's thread is delayed
_PER_SERVO = ("name", "position", "current", "hardware_error", "torque_enabled", "valid", "thermal_reserve", "stray")
_POWER = (
    *("contactor_closed", "charge_current", "target_voltage", "battery_voltage"),
    *("stage_steps_up", "stage_voltage"),
)
SOURCES = ("servo_state", "tactile_frame", "charger_power", "joint_trajectory")
"""Topics that docking uses and only one node may publish."""
SERVERS = ("predict_misalignment", "detect_electrodes", "set_torque", "tare", "probe", "set_contactor")
"""Services that only one node may serve, in addition to docking's own actions, which a second docking_node serves."""
_GOALS = ("dock/_action/send_goal", "undock/_action/send_goal")


class Heard:
    """The latest message of each topic as one `Observation`: what counts as new, how old it is, and whose clock errs.

    Knows no topics and no threads. Ages follow the monotonic clock, stamps the node's.

    Args:
        clock: of the node; stamps are compared with it. While /clock stands still no data count as new.
        host: clock of the computer.

    Attributes:
        refused: number of refused messages.
        last_refusal: why the last one was refused.
    """

    def __init__(self, clock: Clock, host: real_time.HostClock = real_time.HOST) -> None:
        self.refused, self.last_refusal = 0, ""
        self._clock, self._host = clock, host
        self._watch = ClockWatch(clock, host)
        self._frame_check = FrameCheck()
        self._latest: dict[type[Any], Any] = {}  # the latest message of each type
        self._latest_sampled: dict[type[Any], tuple[float, float]] = {}  # its stamp, and the monotonic time, s
        self._taxels = np.zeros((machine.PADS, machine.ROWS, machine.COLUMNS))  # N, of the latest frame
        self._misdated: dict[type[Any], str] = {}  # why a clock is wrong, by the stamp of the last message
        self._measured = dict.fromkeys((ServoState, TactileFrame, ChargerPower), -math.inf)  # and its time, s

    def hear(self, message: Any) -> None:
        """Store new measurements with their time; old data do not become fresh by being sent late or again.

        The time is read before the age: if the thread is interrupted in between, data seem older than they are.
        """
        kind = type(message)
        known = self._latest.get(kind)
        if known is not None and message.header.stamp == known.header.stamp:
            return
        instant = self._host.now()
        try:
            if message.header.stamp.sec < 0 or message.header.stamp.nanosec >= 1_000_000_000:
                raise MessageRefused(f"its stamp is invalid: {message.header.stamp}")
            stamp = messages.seconds(message.header.stamp)
            old = self._age(kind, stamp)
            before, sampled = self._latest_sampled.get(kind, (-math.inf, -math.inf))
            if stamp < before and instant - old < sampled:
                self._misdated[kind] = (
                    f"its stamp is {before - stamp:.3f} s older than one before; {real_time.COMPARE_CLOCKS}"
                )
                raise MessageRefused(self._misdated[kind])
            if kind in _CHECKS:  # charger_power is checked where its values are used
                _CHECKS[kind](message)
        except MessageRefused as refusal:
            self.refused, self.last_refusal = self.refused + 1, f"{_NAMES[kind]}: {refusal}"
            return
        if kind is TactileFrame:
            self._frame_check.add(message.sequence, instant - old)
            self._taxels = np.array((message.left, message.right), np.float64).reshape(
                -1, machine.ROWS, machine.COLUMNS
            )
        if kind is not ServoState or all(message.valid):
            self._measured[kind] = instant - max(old, 0.0)
        self._latest[kind], self._latest_sampled[kind] = message, (stamp, instant - old)

    def observation(self, replies: tuple[Reply, ...] = (), **known: Any) -> Observation:
        """Return the present observation; `known` are its values from elsewhere.

        Estimates of unconfirmed frames are refused.
        """
        now = self._host.now()
        self._watch.look(now)
        misdated = next((f"{_NAMES[kind]}: {problem}" for kind, problem in self._misdated.items() if problem), "")
        servo, tactile, power = (self._latest.get(kind) for kind in self._measured)
        ages = (now - min(measured, self._watch.stepped) for measured in self._measured.values())
        values: dict[str, Any] = dict(zip(("servo_age", "tactile_age", "power_age"), ages, strict=True))
        if servo is not None:
            values.update(
                angles=tuple(servo.position),
                currents=tuple(servo.current),
                servos_valid=all(servo.valid),
                servos_mute=not any(servo.valid),
                hardware_error=int(np.bitwise_or.reduce(np.array(servo.hardware_error, dtype=np.uint8))),
                torque_enabled=all(servo.torque_enabled),
                thermal_reserve=float(np.min(servo.thermal_reserve)),  # NaN if one is unknown
                stopped=machine.in_words(servo.stray),
            )
        if tactile is not None:
            values.update(
                tactile_contact=bool(np.fmax.reduce(self._taxels, axis=None) >= machine.CONTACT_FORCE),
                tared=tactile.tared,
                taxels=self._taxels if tactile.tared else None,
            )
        if power is not None:
            values.update({name: getattr(power, name) for name in _POWER})
            values.update(least_current=power.charge_current_least, power_fault=power.fault)
        return Observation(
            time=now,
            replies=tuple(map(self._frame_check.checked, replies)),
            clock_problem=self._watch.problem(now) or misdated,
            **values,
            **known,
        )

    def _age(self, kind: type[Any], stamp: float) -> float:
        """Return the age (s) of a stamp (s).

        Raises:
            MessageRefused: it shows another clock, or lies in the future.
        """
        old = age(self._clock, stamp, self._host)
        self._misdated[kind] = ""
        if abs(old) > ANOTHER_CLOCK:
            self._misdated[kind] = "it is stamped by another clock: set use_sim_time for all nodes or for none"
        elif -old > real_time.AHEAD:
            self._misdated[kind] = (
                f"its stamp is {-old:.3f} s ahead of this computer's clock; {real_time.COMPARE_CLOCKS}"
            )
        if self._misdated[kind]:
            raise MessageRefused(self._misdated[kind])
        return old


class Inputs:
    """The topics that docking hears, as one `Observation`.

    Topics are read only when an observation is requested, because only the newest message counts. All tactile frames
    are received: an estimate that allows current must come from them.

    Args:
        node: subscribes.
        log: of the node.

    Attributes:
        heard: what they told.
    """

    def __init__(self, node: Node, log: Log) -> None:
        self._log = log
        self._lock = threading.Lock()
        self.heard = Heard(node.get_clock())
        self._servo = on_demand.LatestMessage(node, ServoState, "servo_state", QoSProfile(depth=1))
        self._power = on_demand.LatestMessage(node, ChargerPower, "charger_power", QoSProfile(depth=1))
        sampled = QoSProfile(depth=_BACKLOG, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._frames = on_demand.PolledTopic(node, TactileFrame, "tactile_frame", sampled)
        self._duplicates = diagnostics.Duplicates(node, SOURCES, (*SERVERS, *_GOALS))
        self._double, self._looked, self._steps = "", -math.inf, real_time.HOST.steps

    def wait(self, timeout: float) -> None:
        """Wait for the next servo_state, at most `timeout` s; only for the thread that steps."""
        self._servo.wait(timeout)

    def rest(self) -> None:
        """Let servo_state wake no thread until the next `wait`."""
        self._servo.rest()

    def look(self) -> None:
        """Log second sources and steps of the clock; does nothing within _LOOK of the last call."""
        now = time.monotonic()
        if now - self._looked < _LOOK:
            return
        before = self._double
        self._looked, self._double = now, self._duplicates.look()
        if self._double and self._double != before:
            self._log.warning(f"second source, so the contactor will not be closed: {self._double}")
        if real_time.HOST.steps != self._steps:
            self._steps = real_time.HOST.steps
            self._log.warning(real_time.HOST.problem())

    def observation(self, replies: tuple[Reply, ...] = (), contactor_refusal: str = "") -> Observation:
        """Return the present observation; callable from any thread. Estimates of unconfirmed frames are refused."""
        with self._lock:
            for message in (self._servo.take(), self._power.take()):
                if message is not None:
                    self.heard.hear(message)
            for frame, _ in self._frames.take():
                self.heard.hear(frame)
            return self.heard.observation(
                replies,
                contactor_refusal=contactor_refusal,
                duplicate_sources=self._double,
            )


def _three_servos(message: ServoState) -> None:
    """Refuse a message whose data are missing, foreign or impossible."""
    if any(len(getattr(message, name)) != len(machine.JOINTS) for name in _PER_SERVO):
        raise MessageRefused("its arrays do not describe three servos")
    if list(message.name) != list(machine.JOINTS):
        raise MessageRefused(f"its joints are not {', '.join(machine.JOINTS)}")
    widest = max(0.0, *message.position, key=abs)  # 0.0 first: NaN is not measured
    if problem := texts.outside(widest, -math.pi, math.pi, "rad"):
        raise MessageRefused(f"a position: {problem}")


def _two_pads(message: TactileFrame) -> None:
    sizes = (message.rows, message.columns, len(message.left), len(message.right))
    if sizes != (machine.ROWS, machine.COLUMNS, machine.ROWS * machine.COLUMNS, machine.ROWS * machine.COLUMNS):
        raise MessageRefused(f"its pads do not have {machine.ROWS} × {machine.COLUMNS} taxels")
    if any(np.isinf(pad).any() for pad in (message.left, message.right)):
        raise MessageRefused("a taxel's force is infinite")


_CHECKS: dict[type[Any], Any] = {ServoState: _three_servos, TactileFrame: _two_pads}
_NAMES: dict[type[Any], str] = dict(zip((ServoState, TactileFrame, ChargerPower), SOURCES, strict=False))


_KEPT = 1024  # frames, 8 s: more than the longest request for an estimate takes
_SHARE = 0.5  # of an estimate's frames that docking must have received: a best-effort topic loses some
# The arm has rested for longer than this when an estimate is requested, and clocks of two computers may differ by this
# much (`host_clock.AHEAD`): a frame sampled this long before the request was still sampled after the last move.
_BEFORE = 0.1  # s


class FrameCheck:
    """Stores sequence numbers of recent frames, and checks estimates against them."""

    def __init__(self) -> None:
        self._frames: deque[tuple[int, float]] = deque(maxlen=_KEPT)

    def add(self, sequence: int, sampled: float) -> None:
        """Add a frame sampled at `sampled`, s monotonic."""
        self._frames.append((sequence, sampled))

    def checked(self, reply: Reply) -> Reply:
        """Return the reply, or a refusal in its place if its estimate is not confirmed."""
        if reply.estimate is None:
            return reply
        doubt = self._doubt(reply.sequences, reply.asked - _BEFORE)
        if not doubt:
            return reply
        text = f"the estimate is not confirmed: {doubt}; check for a second server of predict_misalignment"
        return replace(reply, success=False, message=text, estimate=None)

    def _doubt(self, named: tuple[int, ...], since: float) -> str:
        """Return why the frames may not have been sampled after `since` (s, monotonic); '' = no reason."""
        if not named:
            return "it does not name the frames that it averaged"
        if any(later <= earlier for earlier, later in pairwise(named)):
            return "it names tactile frames twice or out of order"
        fresh = {sequence for sequence, sampled in self._frames if sampled > since}
        known = len(fresh.intersection(named))
        if known < _SHARE * len(named) or not known:
            return f"docking received only {known} of its {len(named)} tactile frames after the request"
        first = min(fresh)  # an earlier frame with a higher number is from before a restart of tactile_node
        if any(named[0] <= sequence < first for sequence, sampled in self._frames if sampled <= since):
            return "some of its tactile frames were sampled before the request"
        return ""


class MessageRefused(Exception):
    """A message is refused. Example: its stamp lies in the future."""
