# SPDX-License-Identifier: Apache-2.0
"""Both drivers on a simulated charger, which charges, and charges again after every fault, without dockings."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from builtin_interfaces.msg import Duration
from deltacharger.msg import ChargerPower, ServoState, TactileFrame
from deltacharger.srv import Probe, SetContactor
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from deltacharger_driver.board.tactile_node import TactileNode
from deltacharger_driver.parameters import REPLY_MARGIN
from deltacharger_driver.servos.servo_node import ServoNode
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_ros import qos
from deltacharger_ros.executor import Spinner
from deltacharger_scenes.scene import parse_scene
from deltacharger_sim.charger.faults import Faults

from ..nodes import options
from ..waiting import host, wait_until
from .fault_world import RecordedCharger

SCENE = {"nodes": [], "simulation": {"seed": 3, "rig_seed": 1, "world": {"target": {"y": -0.003, "z": 0.080}}}}
JOINTS = ("limb_0_arm_joint", "limb_1_arm_joint", "limb_2_arm_joint")
PATIENCE = 10.0  # s; far longer than any fault-free operation
DELTA = ScalarDelta()
_RENEWAL, _LEASE = 0.1, 0.25  # s, as docking_node's
_PRESSED = 0.083  # m; goal behind the target's face, for a push by the servos' springs
_FREE = 0.050  # m; in free air
_PULL = 4.0  # N·m of each servo, enough for the magnets
_TOUCH = 1.0  # N
_AT_REST, _RESTS = 0.005, 0.1  # rad/s, s of the world


class FaultClient(Node):
    """Observes and commands the drivers, as docking_node and operator do, and renews its lease in any case.

    Attributes:
        servo, frame, power: the latest messages; None before the first.
        received: number of messages received, by attribute.
        untrue: readings that are physically impossible and should have been NaN.
        unknown_at: when each servo (its id) was last reported as unknown, s, monotonic.
        statuses: of this charger's /diagnostics, with the time of arrival (s, monotonic).
    """

    def __init__(self, context: Context, namespace: str) -> None:
        super().__init__("fault_client", **options(context, namespace))
        self.servo: Any = None
        self.frame: Any = None
        self.power: Any = None
        self.received = {"servo": 0, "frame": 0, "power": 0}
        self.untrue: list[str] = []
        self.unknown_at: dict[int, float] = {}
        self.statuses: list[tuple[float, DiagnosticStatus]] = []
        for kind, topic, quality, name, check in (
            (ServoState, "servo_state", qos.LATEST, "servo", self._servo_problems),
            (TactileFrame, "tactile_frame", qos.SENSOR, "frame", self._frame_problems),
            (ChargerPower, "charger_power", qos.LATEST, "power", self._power_problems),
        ):
            self.create_subscription(kind, topic, self._keeper(name, check), quality)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._trajectories = self.create_publisher(JointTrajectory, "joint_trajectory", qos.LATEST)
        kinds = {"set_torque": SetBool, "reboot_servos": Trigger, "tare": Trigger, "probe": Probe}
        services = {**kinds, "set_contactor": SetContactor}
        self._asked: dict[str, Any] = {name: self.create_client(kind, name) for name, kind in services.items()}
        lease = Duration(nanosec=int(1e9 * host(_LEASE)))
        self._lease = {"close": True, "holder": "fault_client", "lease": lease}
        self._wanted, self._over = threading.Event(), threading.Event()
        self._renewing = threading.Thread(target=self._renew, name="lease", daemon=True)
        self._renewing.start()

    def close(self) -> None:
        self._over.set()
        self._renewing.join()

    def is_connected(self) -> bool:
        ready = all(service.service_is_ready() for service in self._asked.values())
        return ready and all(self.received.values()) and bool(self._trajectories.get_subscription_count())

    def call(self, name: str, **fields: Any) -> Any:
        """Call a service and return its response."""
        service = self._asked[name]
        future = service.call_async(service.srv_type.Request(**fields))
        wait_until(future.done, f"an answer from {name}", PATIENCE)
        return future.result()

    def send(self, points: Sequence[tuple[float, float]], effort: Sequence[float] = ()) -> None:
        """Send (s, z in m) on the axis with a torque bound (N·m) of each servo; () = none."""
        message = JointTrajectory(joint_names=list(JOINTS))
        for seconds, z in points:
            point = JointTrajectoryPoint(positions=DELTA.inverse(0.0, 0.0, z), effort=list(effort))
            point.time_from_start = Duration(sec=int(seconds), nanosec=int(seconds % 1 * 1e9))
            message.points.append(point)
        self._trajectories.publish(message)

    def keep_closed(self) -> None:
        """Close the contactor, and renew the lease from now on, even if it is refused."""
        answer = self.call("set_contactor", **self._lease)
        assert answer.success, answer.message
        self._wanted.set()

    def stop_renewing(self) -> None:
        """Stop renewing the lease."""
        self._wanted.clear()

    def told(self, part: str, since: float = 0.0) -> Iterator[DiagnosticStatus]:
        """Yield the diagnostics of a part after an instant, newest first."""
        for when, status in reversed(list(self.statuses)):
            if when > since and status.name.endswith(part):
                yield status

    def has_warned(self, part: str, words: Sequence[str], since: float) -> bool:
        """Whether `part` has published a warning with these words after `since`."""
        warnings = (each.message for each in self.told(part, since) if each.level > DiagnosticStatus.OK)
        return any(all(word in message for word in words) for message in warnings)

    def value(self, part: str, key: str, since: float = 0.0) -> str:
        """Return the latest value of a part's key after an instant; "0" if it was not published."""
        for status in self.told(part, since):
            return next((value.value for value in status.values if value.key == key), "0")
        return "0"

    def taxels(self) -> np.ndarray:
        """Return the 200 taxels of the latest frame, left first, N."""
        return np.concatenate((self.frame.left, self.frame.right))

    def _renew(self) -> None:
        while not self._over.wait(_RENEWAL):
            if self._wanted.is_set() and self.context.ok():
                self._asked["set_contactor"].call_async(SetContactor.Request(**self._lease))

    def _keeper(self, name: str, problems: Callable[[Any], Iterator[str]]) -> Callable[[Any], None]:
        def keep(message: Any) -> None:
            self.untrue += problems(message)
            setattr(self, name, message)
            self.received[name] += 1

        return keep

    def _servo_problems(self, message: ServoState) -> Iterator[str]:
        columns = (message.position, message.velocity, message.current, message.voltage, message.temperature)
        for servo, row in enumerate(zip(*columns, strict=True), 1):
            unknown = [math.isnan(value) for value in row]
            if all(unknown) and not message.valid[servo - 1]:
                self.unknown_at[servo] = time.monotonic()
            elif any(unknown) or not (5.0 < row[3] < 16.0 and 20.0 < row[4] < 80.0 and abs(row[0]) < 1.5):
                yield f"servo {servo}: {row}, valid {message.valid[servo - 1]}"

    def _frame_problems(self, message: TactileFrame) -> Iterator[str]:
        if len(message.left) != 100 or len(message.right) != 100 or min(message.left) < 0.0:
            yield f"frame {message.sequence}"

    def _power_problems(self, message: ChargerPower) -> Iterator[str]:
        if not 22.0 < message.battery_voltage < 30.0:
            yield f"battery {message.battery_voltage} V"

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        own = f"{self.get_namespace()}/".lstrip("/")
        self.statuses += [(time.monotonic(), status) for status in message.status if status.name.startswith(own)]


class Mark(NamedTuple):
    """An instant: s of the world, s of the monotonic clock, number of events so far, push (N)."""

    world: float
    host: float
    events: int
    push: float


class Bench:
    """The simulated charger, its drivers and their client; `is_well` until a cell fails."""

    def __init__(self, context: Context, namespace: str) -> None:
        self.charger = RecordedCharger.build(parse_scene(SCENE, "faults"), namespace)
        self.world = self.charger.world
        self.is_well = True
        self._spinners: list[Spinner] = []
        try:
            self.charger.start()
            board = options(context, namespace, port=self.charger.board_port)
            margin = min(host(REPLY_MARGIN), 0.1)
            servos = options(context, namespace, port=self.charger.servo_port, reply_margin=margin)
            self._spinners += [Spinner(TactileNode(**board)), Spinner(ServoNode(**servos))]
            self.client = FaultClient(context, namespace)
            self._spinners.append(Spinner(self.client))
            self.wait(self.client.is_connected, "discovery")
            self.tare()
        except BaseException:
            self.close()
            raise

    @property
    def faults(self) -> Faults:
        """Faults of the hardware."""
        assert self.charger.faults is not None
        return self.charger.faults

    def close(self) -> None:
        for spinner in reversed(self._spinners):
            spinner.close()
        self.charger.stop()

    def wait(self, condition: Callable[[], Any], what: str) -> None:
        """Wait for a condition."""
        wait_until(condition, what, PATIENCE)

    def mark(self) -> Mark:
        """Return the present instant, and reset the largest push."""
        self.world.record.peak_push = 0.0
        return Mark(self.world.time, time.monotonic(), len(self.world.events), self.world.push())

    def charge(self) -> None:
        """Let it charge from any state, with a client's means only."""
        if not self._is_pressed():  # the arm must not move while the contactor is closed
            self.client.stop_renewing()
            if self.world.circuit.closed:
                self.ask("set_contactor", close=False)
            self.wait(lambda: not self.client.power.contactor_closed, "the opening to be published")
        self.wait(lambda: all(self.client.servo.valid), "all servos to answer")
        count = self.client.received["frame"]
        self.wait(lambda: self.client.received["frame"] > count, "tactile frames")
        self.ask("set_torque", data=True)
        if not self._is_pressed():
            self._press()
        if not self.is_charging():
            self.ask("probe")
            self.client.keep_closed()
            self.wait(self.is_charging, "charge current")

    def ask(self, name: str, **fields: Any) -> None:
        """Call a service until it has finished another task and succeeds."""
        self.wait(lambda: self.client.call(name, **fields).success, f"{name} {fields or ''}")

    def is_charging(self) -> bool:
        """Whether the contactor is closed and current flows."""
        return self.world.circuit.closed and self.world.circuit.current > 0.5

    def tare(self) -> None:
        """Tare in free air, from any position."""
        if self.world.mechanics.contact_force > 0.0:
            self.ask("set_torque", data=True)
            self.client.send([(0.3, _FREE)], [_PULL] * 3)
            self.wait(lambda: self.world.mechanics.position[2] < _FREE + 0.01, "the arm off the magnets")
        self.ask("tare")
        self.wait(lambda: self.client.frame.tared, "tared frames")

    def _is_pressed(self) -> bool:
        return np.allclose(self.world._reference, DELTA.inverse(0.0, 0.0, _PRESSED), atol=0.002)

    def _press(self) -> None:
        self.client.send([(0.4, _PRESSED)])
        self.wait(self._is_pressed, "the goal behind the target's face")
        self.wait(lambda: np.nanmax(self.client.taxels()) >= _TOUCH, "the pads to measure the target")
        moved = self.world.time  # rest lasts: an instant is also the end of a bounce

        def rests() -> bool:
            nonlocal moved
            if max(map(abs, self.world.mechanics.rates)) >= _AT_REST:
                moved = self.world.time
            return self.world.time - moved > _RESTS

        self.wait(rests, "the arm at rest")
