# SPDX-License-Identifier: Apache-2.0
"""tactile_node with a real ROS client and the emulated board. test_contactor_guard.py has the rules of a close."""

import math
import threading
import time
from collections.abc import Callable, Iterator
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

from deltacharger_core.ros.executor import Spinner
from deltacharger_driver.board import protocol, tactile_node
from deltacharger_driver.ports import PseudoTerminal
from deltacharger_sim.emulators.board import BoardEmulator

from ..chargers import new_namespace, patience
from ..nodes import call, options
from ..plants import BenchPlant
from ..waiting import DEADLINE, host, wait_until

pytestmark = pytest.mark.ros


class Client(Node):
    """A client that uses tactile_node like docking_node."""

    def __init__(self, context: Any, namespace: str) -> None:
        super().__init__("client", **options(context, namespace))
        self.frames: list[TactileFrame] = []
        self.powers: list[ChargerPower] = []
        self.diagnostics: list[DiagnosticArray] = []
        self.batteries: dict[str, list[BatteryState]] = {"battery": [], "target_battery": []}
        group = ReentrantCallbackGroup()
        listened = [
            (TactileFrame, "tactile_frame", self.frames, qos_profile_sensor_data),
            (ChargerPower, "charger_power", self.powers, QoSProfile(depth=1)),
            (DiagnosticArray, "/diagnostics", self.diagnostics, QoSProfile(depth=10)),
            *((BatteryState, topic, messages, QoSProfile(depth=10)) for topic, messages in self.batteries.items()),
        ]
        for kind, topic, messages, qos in listened:
            self.create_subscription(kind, topic, messages.append, qos, callback_group=group)
        self._tare = self.create_client(Trigger, "tare", callback_group=group)
        self._probe = self.create_client(Probe, "probe", callback_group=group)
        self._contactor = self.create_client(SetContactor, "set_contactor", callback_group=group)
        for client in (self._tare, self._probe, self._contactor):
            assert client.wait_for_service(DEADLINE)

    def tare(self) -> Any:
        return call(self._tare, Trigger.Request())

    def probe(self) -> Any:
        return call(self._probe, Probe.Request())

    def contactor(self, close: bool, holder: str = "dock", lease: float = 0.25, token: str = "") -> Any:
        duration = Duration(sec=int(lease), nanosec=int(lease % 1.0 * 1e9))
        request = SetContactor.Request(close=close, holder=holder, lease=duration, token=token)
        request.current_max, request.voltage_max, request.start_time, request.gap_time = 10.0, 29.4, 3.0, 0.2
        return call(self._contactor, request)

    def clear_weld(self) -> Any:
        return call(self._contactor, SetContactor.Request(clear_weld=True))


class Rig:
    """Board, cable, node and client."""

    def __init__(self, directory: Path, context: Any) -> None:
        self.plant = BenchPlant()
        self.board = BoardEmulator(self.plant, seed=5)
        self.path = directory / "board"
        self.cable = PseudoTerminal(self.board, self.path).start()
        namespace = new_namespace()
        self.node = tactile_node.TactileNode(**options(context, namespace, port=str(self.path)))
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

    def dock(self) -> None:
        """Tare, touch, probe: ready to close."""
        assert self.client.tare().success
        self.plant.press(20.0)
        wait_until(lambda: np.nanmax(self.fresh_frame().left) > 4.0)
        answer = self.client.probe()
        assert answer.success, answer.message

    def charge(self, enough: Callable[[], Any]) -> None:
        """Hold the lease as docking_node does until `enough`."""

        def renew() -> Any:
            answer = self.client.contactor(True, lease=host(0.25))
            assert answer.success, answer.message
            time.sleep(0.05)  # the holder's pace, not a wait for a condition
            return enough()

        wait_until(renew)

    def is_closed(self) -> bool:
        return self.plant.read_power().closed

    def stop(self) -> None:
        self.server.close()
        self.spinner.close()
        self.cable.stop()


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory, context: Any) -> Iterator[Rig]:
    with patience():
        rig = Rig(tmp_path_factory.mktemp("tactile"), context)
        yield rig
        rig.stop()


@pytest.fixture
def rig(shared: Rig) -> Rig:
    shared.reset()
    return shared


@pytest.mark.version
def test_probe_and_refusals_are_answered(rig: Rig) -> None:
    assert math.isinf(rig.power().probe_age)
    answer = rig.client.probe()
    assert (answer.success, answer.port, answer.target_voltage) == (True, Probe.Response.PORT_LIVE, 24.0)
    power = rig.power()
    assert (power.stage_steps_up, math.isnan(power.stage_voltage)) == (True, True)
    assert 0.0 <= power.probe_age < 2.0
    for request in ({}, {"lease": -(2.0**31)}, {"holder": "x" * 5_000_000}, {"token": "x" * 5_000_000}):
        answer = rig.client.contactor(True, **request)
        assert not answer.success
        assert 0 < len(answer.message) < 200
    assert not rig.board.contactor_commanded
    assert rig.node._keeper.guard.lease_record()["refused_closes"] >= 4
    rig.plant.target = -24.0
    answer = rig.client.probe()
    assert (answer.success, answer.port) == (True, Probe.Response.PORT_REVERSED)  # measured, even if it forbids a close
    rig.plant.target = 24.0
    rig.board.trip(protocol.BoardFault.CONTACTOR_WELDED)
    wait_until(lambda: rig.power().fault == ChargerPower.FAULT_CONTACTOR_WELDED)
    assert "welded" in rig.client.probe().message
    assert "24.0 V" in rig.client.clear_weld().message
    rig.plant.resistance = math.inf
    assert rig.client.clear_weld().success
    assert rig.client.probe().success


def test_late_orders_are_refused_with_their_age_but_never_an_opening(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tactile_node, "order_age", lambda: 2.3)
    for answer in (rig.client.tare(), rig.client.probe(), rig.client.contactor(True)):
        assert not answer.success
        assert "2.3 s ago" in answer.message
    assert not rig.board.contactor_commanded
    assert rig.client.contactor(False).success


def status_of(rig: Rig, part: str) -> dict[str, str]:
    """Return the values of the part's newest status; none if there is none yet."""
    statuses = [s for message in rig.client.diagnostics[-1:] for s in message.status if s.name.endswith(part)]
    return {value.key: value.value for status in statuses for value in status.values}


@pytest.mark.witness
@pytest.mark.version
def test_a_held_lease_charges_and_is_reported_until_it_lapses(rig: Rig) -> None:
    def charging() -> bool:
        own, target = (messages[-1:] for messages in rig.client.batteries.values())
        statuses = [battery.power_supply_status for battery in own + target]
        reported = status_of(rig, "power stage").get("holder") == "dock"
        return reported and statuses == [
            BatteryState.POWER_SUPPLY_STATUS_DISCHARGING,
            BatteryState.POWER_SUPPLY_STATUS_CHARGING,
        ]

    rig.dock()
    rig.charge(charging)
    assert rig.client.powers[-1].contactor_closed
    assert rig.client.powers[-1].charge_current >= rig.client.powers[-1].charge_current_least > 0.5
    target = rig.client.batteries["target_battery"][-1]
    assert 24.0 < target.voltage < 29.5
    assert target.current > 0.5
    now = rig.client.get_clock().now().nanoseconds * 1e-9
    assert -0.1 < now - (target.header.stamp.sec + 1e-9 * target.header.stamp.nanosec) < 10.0
    power, pads = (status_of(rig, part) for part in ("power stage", "tactile arrays"))
    assert 0.0 < float(power["lease_left"].removesuffix(" s")) <= host(0.25)
    assert int(power["lease_renewals"]) > 0
    assert 0.0 < float(pads["rate"].removesuffix(" Hz")) <= 140.0
    renewed = time.monotonic()
    wait_until(lambda: not rig.is_closed())
    assert time.monotonic() - renewed < host(0.4)
    assert rig.power().fault == 0
    answer = rig.client.contactor(True)
    assert not answer.success
    assert "probe" in answer.message


def test_an_unplugged_board_has_no_values_and_is_back_once_replugged(rig: Rig) -> None:
    rig.cable.unplug()
    for messages in rig.client.batteries.values():
        wait_until(lambda messages=messages: messages and math.isnan(messages[-1].voltage) and not messages[-1].present)
    assert "not connected" in rig.client.tare().message
    rig.cable.replug()
    rig.fresh_frame()


def test_close_opens_the_contactor_reports_it_and_releases_the_port(tmp_path: Path, context: Any) -> None:
    rig = Rig(tmp_path, context)
    rig.fresh_frame()
    rig.dock()
    rig.charge(lambda: rig.client.powers and rig.client.powers[-1].contactor_closed)
    rig.client.powers.clear()
    rig.node.close()
    wait_until(lambda: sum(not each.contactor_closed for each in rig.client.powers) > 1, "reports of the opening")
    assert not rig.is_closed()
    assert rig.board.fault == 0
    assert not [t for t in threading.enumerate() if str(rig.path) in t.name]
    assert not rig.client.contactor(True).success
    rig.node.close()
    rig.stop()
