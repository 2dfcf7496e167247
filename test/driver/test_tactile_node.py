# SPDX-License-Identifier: Apache-2.0
"""tactile_node with a real ROS client, a pseudo-terminal, the emulated board and a bench plant."""

from __future__ import annotations

import itertools
import math
import threading
import time
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from deltacharger.msg import ChargerPower, TactileFrame
from deltacharger.srv import Probe, SetContactor
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import BatteryState
from std_srvs.srv import Trigger

from deltacharger_driver.board.protocol import BoardFault, PacketType
from deltacharger_driver.board.tactile_node import TactileNode
from deltacharger_driver.emulators.bench_plant import BenchPlant
from deltacharger_driver.emulators.board import BoardEmulator
from deltacharger_driver.emulators.wire_faults import WireFaults
from deltacharger_driver.pseudo_terminal import PseudoTerminal
from deltacharger_ros.executor import Spinner
from deltacharger_ros.node_support import StartupError

from ..chargers import DEADLINE, new_namespace, wait_until
from ..nodes import call, options

pytestmark = pytest.mark.ros

AT_ONCE = 8  # requests; a service queues ten


class Client(Node):
    """A client that uses tactile_node like docking_node."""

    def __init__(self, context: Any, namespace: str) -> None:
        super().__init__("client", **options(context, namespace))
        self.frames: list[TactileFrame] = []
        self.powers: list[ChargerPower] = []
        self.diagnostics: list[DiagnosticArray] = []
        self.batteries: dict[str, list[BatteryState]] = {"battery": [], "target_battery": []}
        group = ReentrantCallbackGroup()
        self.create_subscription(
            TactileFrame, "tactile_frame", self.frames.append, qos_profile_sensor_data, callback_group=group
        )
        self.create_subscription(
            ChargerPower, "charger_power", self.powers.append, QoSProfile(depth=1), callback_group=group
        )
        self.create_subscription(DiagnosticArray, "/diagnostics", self.diagnostics.append, 10, callback_group=group)
        for topic, messages in self.batteries.items():
            self.create_subscription(BatteryState, topic, messages.append, 10, callback_group=group)
        self._tare = self.create_client(Trigger, "tare", callback_group=group)
        self._probe = self.create_client(Probe, "probe", callback_group=group)
        self._contactor = self.create_client(SetContactor, "set_contactor", callback_group=group)
        for client in (self._tare, self._probe, self._contactor):
            assert client.wait_for_service(DEADLINE)

    def tare(self) -> Any:
        return call(self._tare, Trigger.Request())

    def probe(self) -> Any:
        return call(self._probe, Probe.Request())

    def probing(self) -> Any:
        return self._probe.call_async(Probe.Request())

    def contactor(self, close: bool, holder: str = "dock", lease: float = 0.25, token: str = "") -> Any:
        return call(self._contactor, contactor_request(close, holder, lease, token))

    def contacting(self) -> Any:
        return self._contactor.call_async(contactor_request(True, "dock", 0.25, ""))


def contactor_request(close: bool, holder: str, lease: float, token: str) -> SetContactor.Request:
    duration = Duration(sec=int(lease), nanosec=int(lease % 1.0 * 1e9))
    return SetContactor.Request(close=close, holder=holder, lease=duration, token=token)


class Rig:
    """Board, cable, node and client."""

    def __init__(self, directory: Path, context: Any) -> None:
        self.plant = BenchPlant()
        self.board = BoardEmulator(self.plant, seed=5)
        self.path = directory / "board"
        self.cable = PseudoTerminal(self.board, self.path).start()
        namespace = new_namespace()
        self.node = TactileNode(**options(context, namespace, port=str(self.path)))
        self.server = Spinner(self.node)
        self.client = Client(context, namespace)
        self.spinner = Spinner(self.client)

    def reset(self) -> None:
        """Restore the state after power-up."""
        self.cable.replug()
        self.plant.press(0.0)
        self.plant.resistance, self.plant.target, self.plant.detected = 2.0, 24.0, 0
        self.board.reboot()
        self.client.contactor(False)
        wait_until(lambda: not self.power().contactor_closed and not self.power().fault)
        self.fresh_frame()

    def fresh_frame(self) -> TactileFrame:
        self.client.frames.clear()
        wait_until(lambda: len(self.client.frames) > 2)
        return self.client.frames[-1]

    def power(self) -> ChargerPower:
        self.client.powers.clear()
        wait_until(lambda: len(self.client.powers) > 1)
        return self.client.powers[-1]

    def batteries(self) -> tuple[BatteryState, BatteryState]:
        """Return the next messages of the charger's battery and of the target's."""
        for messages in self.client.batteries.values():
            messages.clear()
        own, target = self.client.batteries.values()
        wait_until(lambda: own and target, "both batteries")
        return own[-1], target[-1]

    def dock(self) -> None:
        """Tare, touch, probe: ready to close."""
        assert self.client.tare().success
        self.plant.press(20.0)
        self.wait_for_contact()
        answer = self.client.probe()
        assert answer.success, answer.message

    def wait_for_contact(self) -> None:
        wait_until(lambda: np.nanmax(self.fresh_frame().left) > 4.0)

    def charge(self, seconds: float) -> None:
        """Hold the lease as docking_node does and check the current."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            answer = self.client.contactor(True)
            assert answer.success, answer.message
            time.sleep(0.1)  # the holder's 10 Hz, not a wait for a condition

    def stop(self) -> None:
        self.server.close()
        self.spinner.close()
        self.cable.stop()


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory, context: Any) -> Iterator[Rig]:
    rig = Rig(tmp_path_factory.mktemp("tactile"), context)
    yield rig
    rig.stop()


@pytest.fixture
def rig(shared: Rig) -> Rig:
    shared.reset()
    return shared


def test_both_batteries_are_published_as_measured(rig: Rig) -> None:
    rig.plant.resistance = math.inf
    rig.power()
    own, target = rig.batteries()
    assert own.voltage == pytest.approx(rig.power().battery_voltage, abs=0.1)
    assert own.present
    assert not target.present
    rig.plant.resistance = 2.0
    rig.dock()
    rig.charge(2.0)
    own_ones, target_ones = rig.client.batteries.values()
    target = next(each for each in target_ones if each.power_supply_status == each.POWER_SUPPLY_STATUS_CHARGING)
    assert target.voltage == pytest.approx(24.0, abs=2.0)
    assert target.current == pytest.approx((own.voltage - 24.0) / 2.0, abs=0.2)
    assert any(each.power_supply_status == each.POWER_SUPPLY_STATUS_DISCHARGING for each in own_ones)
    now = rig.client.get_clock().now().nanoseconds * 1e-9
    assert -0.1 < now - (target.header.stamp.sec + 1e-9 * target.header.stamp.nanosec) < 10.0
    rig.client.contactor(False)
    rig.cable.unplug()
    wait_until(lambda: not rig.batteries()[0].present, "the board's silence")
    for battery in rig.batteries():
        assert math.isnan(battery.voltage)
        assert battery.power_supply_status == BatteryState.POWER_SUPPLY_STATUS_UNKNOWN


def test_frames_are_complete_and_stamped_with_the_sampling_instant(rig: Rig) -> None:
    rig.plant.left[0, 0] = 5.0
    rig.plant.right[9, 9] = 3.0
    rig.board.set_dead(1, 0, 0)
    frame = rig.fresh_frame()
    rig.board.set_dead(1, 0, 0, dead=False)
    now = rig.client.get_clock().now().nanoseconds * 1e-9
    stamp = frame.header.stamp.sec + frame.header.stamp.nanosec * 1e-9
    assert -0.01 < now - stamp < 0.2
    assert frame.header.frame_id == "end_effector"
    assert (frame.rows, frame.columns, len(frame.left), len(frame.right)) == (10, 10, 100, 100)
    assert frame.pitch == pytest.approx(0.0024)
    assert isinstance(frame.left, array)
    assert frame.left[0] > 4.5
    assert frame.right[99] > 2.5
    assert math.isnan(frame.right[0])


def test_set_contactor_is_answered_at_once_while_the_board_probes(rig: Rig) -> None:
    rig.plant.press(20.0)
    rig.wait_for_contact()

    def slowest() -> float:
        """Return the longest time of an answer, s; inf if the probe ended before."""
        probe = rig.client.probing()
        times = [time.monotonic()]
        for close in (False, True, False):
            rig.client.contactor(close)
            times.append(time.monotonic())
        late = max(end - begin for begin, end in itertools.pairwise(times)) if not probe.done() else math.inf
        wait_until(probe.done)
        return late

    wait_until(lambda: slowest() < 0.020)  # a busy computer may be late, but not always


def test_probe(rig: Rig) -> None:
    assert math.isinf(rig.power().probe_age)
    answer = rig.client.probe()
    assert (answer.success, answer.resistance, answer.target_voltage) == (True, 2.0, 24.0)
    power = rig.power()
    assert power.probe_resistance == 2.0
    assert 0.0 <= power.probe_age < 1.0
    rig.plant.resistance = 0.1
    answer = rig.client.probe()
    assert answer.success  # measured, even if it is a short
    assert answer.resistance == pytest.approx(0.1)


def test_a_held_lease_charges_and_an_open_ends_it(rig: Rig) -> None:
    rig.dock()
    rig.charge(0.6)
    power = rig.client.powers[-1]
    assert power.contactor_closed
    assert power.charge_current == pytest.approx(1.0)
    rig.charge(0.1)
    assert rig.client.contactor(False, "somebody else").success
    wait_until(lambda: not rig.plant.read_power()[3])
    power = rig.power()
    assert math.isinf(power.probe_age)
    assert power.fault == 0
    answer = rig.client.contactor(True)
    assert not answer.success
    assert "call probe" in answer.message


def test_a_lease_that_is_not_renewed_lapses_without_a_fault(rig: Rig) -> None:
    rig.dock()
    rig.charge(0.3)
    began = time.monotonic()
    wait_until(lambda: not rig.plant.read_power()[3])
    assert time.monotonic() - began < 0.4
    assert rig.power().fault == 0
    answer = rig.client.contactor(True)
    assert not answer.success
    assert "probe" in answer.message


@pytest.mark.parametrize(
    ("trouble", "words"),
    [("no contact", "no contact"), ("short", "short circuit"), ("fault", "over current")],
)
def test_reasons_to_refuse_a_close(rig: Rig, trouble: str, words: str) -> None:
    if trouble == "short":
        rig.plant.resistance = 0.5
    rig.dock()
    if trouble == "no contact":
        rig.plant.press(0.0)
        wait_until(lambda: np.nanmax(rig.fresh_frame().left) < 1.0)
        time.sleep(0.12)  # contact within the last 0.1 s counts
    elif trouble == "fault":
        rig.board.trip(BoardFault.OVER_CURRENT)
        wait_until(lambda: rig.power().fault)
        rig.client.probe()
    answer = rig.client.contactor(True, "dock")
    assert not answer.success
    assert words in answer.message
    assert not rig.board.contactor_commanded
    assert rig.power().fault == (BoardFault.OVER_CURRENT if trouble == "fault" else 0)


def test_stale_frames_refuse_a_close(rig: Rig) -> None:
    rig.dock()
    rig.board.faults.inject("drop", 1000, PacketType.TACTILE)
    time.sleep(0.15)  # the silence itself
    answer = rig.client.contactor(True)
    assert not answer.success
    assert "stale" in answer.message
    rig.board.faults = WireFaults()
    rig.fresh_frame()


def test_a_latched_fault_ends_the_lease_and_only_an_open_clears_it(rig: Rig) -> None:
    rig.dock()
    rig.charge(0.3)
    rig.board.trip(BoardFault.REVERSE_CURRENT)
    wait_until(lambda: rig.power().fault == BoardFault.REVERSE_CURRENT)
    answer = rig.client.contactor(True)
    assert not answer.success
    assert "reverse current" in answer.message
    time.sleep(0.4)  # a lapse would have opened by now, which clears the fault
    assert rig.power().fault == BoardFault.REVERSE_CURRENT
    assert rig.client.contactor(False).success
    wait_until(lambda: rig.power().fault == 0)


def test_a_probe_while_closed_is_refused(rig: Rig) -> None:
    rig.dock()
    assert rig.client.contactor(True).success
    answer = rig.client.probe()
    assert not answer.success
    assert "keeps the contactor closed" in answer.message


def signal_probe(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Return an event that is set when the board is asked for a probe."""
    link, begun = rig.node._keeper.link, threading.Event()
    measure = link.probe

    def probe() -> Any:
        begun.set()
        return measure()

    monkeypatch.setattr(link, "probe", probe)
    return begun


def test_a_close_waits_for_another_clients_probe_and_precedes_the_next(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.dock()
    begun = signal_probe(rig, monkeypatch)
    probes = [rig.client.probing()]
    assert begun.wait(DEADLINE), "a running probe"
    probe = rig.node._keeper.guard._probe
    closing = rig.client.contacting()
    wait_until(lambda: probe._priority, "the close to wait")
    probes += [rig.client.probing() for _ in range(AT_ONCE)]
    wait_until(lambda: closing.done() and all(each.done() for each in probes), "all answers")
    assert closing.result().success, closing.result().message
    assert probes[0].result().success  # the running one
    assert rig.client.contactor(False).success


def test_concurrent_probes_share_one_measurement(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    link, measured = rig.node._keeper.link, list[float]()
    measure = link.probe

    def probe() -> Any:
        measured.append(time.monotonic())
        return measure()

    monkeypatch.setattr(link, "probe", probe)
    probes = [rig.client.probing() for _ in range(AT_ONCE)]
    wait_until(lambda: all(each.done() for each in probes), "all answers")
    assert {(each.result().success, each.result().resistance) for each in probes} == {(True, 2.0)}
    assert len(measured) < AT_ONCE // 2  # one, unless requests arrived late


def test_only_the_token_renews_and_any_client_opens(rig: Rig) -> None:
    rig.dock()
    assert rig.client.contactor(True, token="secret").success
    answer = rig.client.contactor(True)
    assert not answer.success
    assert "'dock' holds the contactor" in answer.message
    assert rig.client.contactor(True, token="secret").success
    assert rig.client.contactor(False, "somebody else").success


@pytest.mark.parametrize(
    "request_",
    [
        {"lease": -1.0},
        {"lease": -(2.0**31)},
        {"lease": 0.0},
        {"holder": ""},
        {"holder": "x" * 5_000_000},
        {"token": "x" * 5_000_000},
    ],
)
def test_impossible_closes_are_refused_counted_and_followed_by_a_good_one(rig: Rig, request_: dict[str, Any]) -> None:
    rig.dock()
    refused = int(rig.node._keeper.guard.lease_record()["refused_closes"])  # type: ignore[call-overload]
    answer = rig.client.contactor(True, **request_)
    assert not answer.success
    assert len(answer.message) < 200
    assert rig.node._keeper.guard.lease_record()["refused_closes"] == refused + 1
    assert not rig.board.contactor_commanded
    answer = rig.client.contactor(True, lease=2.0**31 - 1)  # an endless lease is shortened
    assert answer.success, answer.message
    assert rig.node._keeper.guard.remaining() <= 0.25


def test_an_open_does_not_wait_for_a_probe(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, answers = signal_probe(rig, monkeypatch), list[Any]()
    prober = threading.Thread(target=lambda: answers.append(rig.client.probe()))
    prober.start()
    assert begun.wait(DEADLINE), "a running probe"
    began = time.monotonic()
    assert rig.client.contactor(False).success
    assert time.monotonic() - began < 0.12
    prober.join()
    assert not answers[0].success
    assert math.isnan(answers[0].resistance)


def test_frames_flow_while_services_wait(rig: Rig) -> None:
    rig.client.frames.clear()
    for _ in range(3):
        rig.client.probe()
    assert len(rig.client.frames) > 40  # three probes take 0.45 s


def test_a_reboot_while_charging_ends_the_lease(rig: Rig) -> None:
    rig.dock()
    rig.charge(0.3)
    assert rig.fresh_frame().tared
    rig.board.reboot()
    wait_until(lambda: not rig.plant.read_power()[3])
    assert not rig.fresh_frame().tared
    rig.wait_for_contact()
    rig.power()
    answer = rig.client.contactor(True)
    assert not answer.success
    assert "probe" in answer.message


def test_unplugging_while_charging_opens_and_replugging_recovers(rig: Rig) -> None:
    rig.dock()
    rig.charge(0.3)
    rig.cable.unplug()
    wait_until(lambda: not rig.client.contactor(True).success, "a refusal")
    wait_until(lambda: not rig.board.contactor_commanded)
    assert rig.board.fault == BoardFault.HEARTBEAT_LOST
    rig.client.frames.clear()
    assert not rig.client.tare().success
    rig.cable.replug()
    rig.fresh_frame()
    assert not rig.client.contactor(True).success
    assert not rig.plant.read_power()[3]
    assert rig.power().fault == BoardFault.HEARTBEAT_LOST


def values_of(rig: Rig, part: str) -> dict[str, str]:
    """Return the values of the part's next status."""
    rig.client.diagnostics.clear()
    wait_until(lambda: len(rig.client.diagnostics) >= 2)
    status = next(s for s in rig.client.diagnostics[-1].status if s.name.endswith(part))
    return {value.key: value.value for value in status.values}


def test_diagnostics_report_rates_the_lease_and_the_heartbeat(rig: Rig) -> None:
    before = values_of(rig, "power stage")
    assert before["holder"] == ""
    rig.dock()
    rig.charge(1.5)
    rig.client.diagnostics.clear()
    while len(rig.client.diagnostics) < 2:
        rig.charge(0.1)
    status = {s.name.rsplit(": ", 1)[1]: s for s in rig.client.diagnostics[-1].status}
    values = {name: {v.key: v.value for v in s.values} for name, s in status.items()}
    power, link, pads = values["power stage"], values["board link"], values["tactile arrays"]
    assert power["holder"] == "dock"
    assert 0.0 < float(power["lease_left"].removesuffix(" s")) <= 0.25
    assert int(power["lease_renewals"]) > int(before["lease_renewals"]) + 10
    assert 0.0 < float(power["rate"].removesuffix(" Hz")) <= 25.0
    assert 0.0 < float(pads["rate"].removesuffix(" Hz")) <= 140.0
    assert int(pads["late_frames"]) >= 0
    p99, largest = (float(link[key].removesuffix(" ms")) for key in ("heartbeat_late_p99", "heartbeat_late_max"))
    assert 0.0 <= p99 <= largest < 1000.0
    wait_until(lambda: not rig.plant.read_power()[3])  # not renewed: it lapses
    after = values_of(rig, "power stage")
    assert after["holder"] == ""
    assert int(after["lease_lapses"]) == int(before["lease_lapses"]) + 1
    assert int(after["openings"]) > int(before["openings"])


def test_a_replugged_board_is_back_within_two_seconds(rig: Rig) -> None:
    rig.cable.unplug()
    time.sleep(2.0)  # longer than the longest pause between two attempts
    rig.client.frames.clear()
    began = time.monotonic()
    rig.cable.replug()
    wait_until(lambda: rig.client.frames)
    assert time.monotonic() - began < 2.0


def test_close_opens_the_contactor_and_releases_the_port(tmp_path: Path, context: Any) -> None:
    rig = Rig(tmp_path, context)
    rig.fresh_frame()
    rig.dock()
    rig.charge(0.3)
    assert rig.plant.read_power()[3]
    rig.node.close()
    assert not rig.plant.read_power()[3]
    assert rig.board.fault == 0
    assert not [t for t in threading.enumerate() if str(rig.path) in t.name]
    assert not rig.client.contactor(True).success
    rig.node.close()
    rig.stop()


@pytest.mark.parametrize(
    ("parameter", "words"),
    [
        ({"port": "/nowhere"}, "no such port"),
        ({"rate": 1000.0}, "rate"),
        ({"prot": "x"}, "did you mean 'port'"),
        ({"pitch": 0.0}, "pitch"),
    ],
)
def test_bad_parameters_stop_the_node(context: Any, parameter: dict[str, Any], words: str) -> None:
    with pytest.raises(StartupError, match=words):
        TactileNode(**options(context, **parameter))
