# SPDX-License-Identifier: Apache-2.0
"""A charger's messages, from its topics or a recording, as the view's plain values, at limited rates."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from rclpy.context import Context
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Image

from deltacharger_bringup.records.recording import mcap_recording, recorded
from deltacharger_bringup.records.recording.mcap_recording import TOPICS as RECORDED
from deltacharger_bringup.records.replay.words import numbers
from deltacharger_bringup.records.view.log import ViewLog
from deltacharger_bringup.records.view.shapes import pad_picture
from deltacharger_core.mcap_file import RecordingError
from deltacharger_core.ros import client, messages, qos
from deltacharger_docking.contact import ContactCurrent
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_kinematics.scalar import ScalarDelta

SERVOS, PADS, POWER, FELT, SEEN = (
    "servo_state", "tactile_frame", "charger_power", "misalignment", "electrode_detection",
)  # fmt: skip
FEEDBACK = "dock/_action/feedback"
DETECTION_IMAGE, COLOR_IMAGE = "electrode_detection/image", "color/image_raw"

RATES = {SERVOS: 30.0, PADS: 30.0, FELT: 30.0, FEEDBACK: 30.0, DETECTION_IMAGE: 5.0, COLOR_IMAGE: 5.0}
"""Highest display rate (Hz) of a topic; the others are displayed completely."""
ALWAYS_THERE = (SERVOS, PADS, POWER, mcap_recording.STATE)
"""Topics published while a charger runs; the others are published while it docks."""
_SHOWN = (SERVOS, PADS, POWER, FELT, SEEN, mcap_recording.STATE, mcap_recording.DECISION, FEEDBACK)
TOPICS: tuple[mcap_recording.Topic, ...] = (
    *(topic for topic in RECORDED if topic.name in _SHOWN),
    mcap_recording.Topic(DETECTION_IMAGE, Image, qos.SENSOR, queue=5),
    mcap_recording.Topic(COLOR_IMAGE, Image, qos.SENSOR, queue=5),
)
"""Displayed topics and their types."""

_BACKWARD = 1_000_000_000  # ns; a clock that went back further restarts the limits
_ENERGY_STEP = 0.2  # s, longest gap between two charger_power that counts, as in docking_node


class ViewFeed:
    """Takes messages and fills a view.

    Args:
        log: to fill.
        geometry: of the arm.
        parameters: of docking_node; their gravity gives the contact current; None = the defaults.

    Attributes:
        counts: received messages, by relative topic.
        refused: topics with an invalid message: the problem of the first one.
    """

    def __init__(self, log: ViewLog, geometry: DeltaGeometry, parameters: DockingParameters | None = None) -> None:
        self.counts: Counter[str] = Counter()
        self.refused: dict[str, str] = {}
        self._log = log
        self._delta = ScalarDelta(geometry)
        self._contact = ContactCurrent(self._delta, parameters or DockingParameters())
        self._due: dict[str, int] = {}
        self._phase = ""
        self._energy = 0.0
        self._power_at = math.nan
        self._takers: dict[str, Callable[[Any, float], None]] = {
            SERVOS: self._on_servos,
            PADS: self._on_pads,
            POWER: self._on_power,
            FELT: self._on_misalignment,
            SEEN: self._on_detection,
            mcap_recording.STATE: self._on_state,
            mcap_recording.DECISION: self._on_decision,
            FEEDBACK: self._on_feedback,
            DETECTION_IMAGE: lambda message, now: self._on_image("detection", message),
            COLOR_IMAGE: lambda message, now: self._on_image("color", message),
        }

    def take_message(self, topic: str, received: int, decode: Callable[[], Any]) -> None:
        """Take a message.

        Args:
            topic: relative name.
            received: ns since 1970.
            decode: returns the message; called only if it is displayed.
        """
        self.counts[topic] += 1
        if not self._is_due(topic, received):
            return
        self._log.at(received)
        try:
            self._takers[topic](decode(), 1e-9 * received)
        except ValueError as error:  # a foreign message; the others are still displayed
            if topic not in self.refused:
                self.refused[topic] = str(error)
                self._log.line(f"{topic} cannot be shown: {error}", level="WARN")

    def _is_due(self, topic: str, received: int) -> bool:
        rate = RATES.get(topic)
        if rate is None:
            return True
        due = self._due.get(topic, 0)
        if due - _BACKWARD < received < due:
            return False
        period = round(1e9 / rate)
        self._due[topic] = due + period if received < due + period else received + period
        return True

    def _on_servos(self, message: Any, now: float) -> None:
        if len(message.position) != 3 or len(message.current) != 3:
            return
        position = self._delta.forward(*message.position)
        if not math.isfinite(sum(position)):
            return
        self._log.arm(message.position, position)
        angles, currents = tuple(message.position), tuple(message.current)
        self._contact.update(now, angles, currents)
        self._log.contact(self._contact.value, currents)

    def _on_pads(self, message: Any, now: float) -> None:
        rows, columns = message.rows, message.columns
        if not len(message.left) == len(message.right) == rows * columns:
            return
        sums = tuple(sum(force for force in pad if force == force) for pad in (message.left, message.right))
        left, right = (pad_picture(pad, rows, columns) for pad in (message.left, message.right))
        self._log.pads(left, right, (sums[0], sums[1]))

    def _on_power(self, message: Any, now: float) -> None:
        power = message.charge_current * message.target_voltage
        passed = now - self._power_at
        if message.contactor_closed and math.isfinite(power) and passed > 0.0:
            self._energy += power * min(passed, _ENERGY_STEP)
        self._power_at = now
        self._log.power(message.charge_current, message.target_voltage, message.battery_voltage, self._energy)
        self._log.state("contactor", "closed" if message.contactor_closed else "open")

    def _on_misalignment(self, message: Any, now: float) -> None:
        names = ("horizontal", "vertical", "angle")
        measured = {name: (getattr(message, name), getattr(message, f"{name}_stddev")) for name in names}
        self._log.misalignment(measured if message.contact else dict.fromkeys(names, (math.nan, math.nan)))

    def _on_detection(self, message: Any, now: float) -> None:
        place = message.pose.pose.position
        self._log.target("seen", (place.x, place.y, place.z), message.roll)

    def _on_state(self, message: Any, now: float) -> None:
        phase = messages.PHASES.get(message.state, f"state {message.state}")
        if self._phase in ("", "idle") and phase != "idle" and not message.docked:
            self._energy = 0.0
        self._phase = phase
        failure = ""
        if message.error_code:
            failure = f"{message.error_code} {messages.CODES.get(message.error_code, '')}: {message.error_message}"
        if self._log.state("docking", phase) or failure:
            self._log.line(failure or phase.replace("_", " "), level="ERROR" if failure else "INFO")
        self._log.state("docked", "docked" if message.docked else "no")
        self._log.status(status_page(message, phase, failure))

    def _on_decision(self, message: Any, now: float) -> None:
        values = dict(zip(message.names, message.values, strict=False))
        numbered = f" ({numbers(values)})" if values else ""
        self._log.line(f"{message.kind}: {message.text}{numbered}", message.kind)
        if message.kind == "zero":  # docking_node has zeroed its contact current, too
            self._contact.tare()
        place = [values.get(f"{axis}_m", math.nan) for axis in "xyz"]
        if message.kind in ("accepted", "located") and math.isfinite(sum(place)):
            name = "given" if message.kind == "accepted" else "seen"
            self._log.target(name, place, values.get("roll_rad", 0.0))

    def _on_feedback(self, message: Any, now: float) -> None:
        self._log.reported(message.feedback.contact_current)
        if not self.counts[FELT]:  # unless configured, misalignment_node only answers docking_node's calls
            self._on_misalignment(message.feedback.misalignment, now)

    def _on_image(self, name: str, message: Any) -> None:
        from deltacharger_vision.cameras.ros_formats import color_array

        pixels = color_array(message)
        self._log.picture(name, (pixels >> 8).astype("uint8") if pixels.dtype == "uint16" else pixels)


def status_page(message: Any, phase: str, failure: str) -> str:
    """Return docking_state as Markdown."""
    lines = [f"# {phase.replace('_', ' ')}", ""]
    lines.append(
        f"{'**docked**' if message.docked else 'not docked'}, {'**charging**' if message.charging else 'not charging'}"
    )
    if message.request_id:
        lines += ["", f"request `{message.request_id}`"]
    if failure:
        lines += ["", f"last failure: {failure}"]
    return "\n".join(lines)


class Listener(client.Guest):
    """Subscribes, and passes messages to a feed; messages that are not displayed are not even decoded.

    It uses no executor: at 300 messages a second, that costs more than displaying them, and latency does not matter.

    Args:
        context: a running rclpy context.
        namespace: of the charger.
        topics: relative names; their queues must hold the messages between two polls.
    """

    def __init__(self, context: Context, namespace: str, topics: Sequence[mcap_recording.Topic]) -> None:
        super().__init__("charger_view", context, namespace)
        self._topics = mcap_recording.PolledTopics(self.node, topics)
        self._by_name = {self.node.resolve_topic_name(topic.name): topic for topic in topics}

    def hand(self, feed: ViewFeed) -> None:
        """Pass all messages since the last call to `feed`, in the order of arrival."""
        for message in self._topics.take_messages():
            topic = self._by_name[message.topic]
            feed.take_message(topic.name, message.received, partial(deserialize_message, message.data, topic.kind))


def play(recording: recorded.Recording, feed: ViewFeed, stop: Callable[[], bool]) -> None:
    """Pass every message to `feed` at full speed, until `stop`.

    Raises:
        RecordingError: the file is damaged or truncated.
    """
    for topic, received, data in recording.messages():
        if stop():
            return
        feed.take_message(topic.name, received, partial(recorded.decode, data, topic.kind))
    if recording.damage:
        raise RecordingError(f"{recording.path}: {recording.damage}")
