# SPDX-License-Identifier: Apache-2.0
"""Whole charges of ten kinds of targets, the compiled firmware as board, over the link's bytes, in virtual time."""

import random
from dataclasses import replace
from typing import Any

import pytest

from deltacharger_core.machine import ChargeLimits
from deltacharger_docking.parameters import DockingParameters
from deltacharger_driver.board import protocol
from deltacharger_driver.packets import Packet, PacketDecoder, encode_packet
from deltacharger_lab.campaigns.targets import LIMIT, ROWS, TargetCase
from deltacharger_sim.circuit import Circuit
from deltacharger_sim.emulators.power import Outputs, StageParameters
from deltacharger_sim.parameters import WorldParameters
from deltacharger_sim.virtual.virtual_charger import GOAL, VirtualCharger
from test.firmware.board_host import BoardHost
from test.firmware.build import host_programs

pytestmark = pytest.mark.night

KINDS = (
    *("asleep", "diode", "unpowered_input", "inrush_pause", "cut_at_full"),
    *("balancing", "regeneration", "bounce", "wrong_pack", "lithium_iron"),
)


class FirmwarePower:
    """The firmware in place of the emulated power stage: the circuit's readings in, its outputs out, packets between.

    Args:
        circuit: the physics.
        parameters: of the stage.
    """

    def __init__(self, circuit: Circuit, parameters: StageParameters) -> None:
        self._circuit, self.parameters = circuit, parameters
        self.host = BoardHost(host_programs() / "board_host")
        self._decoder, self._sequence = PacketDecoder(), 0
        self._answers: dict[int, Any] = {}
        self._power = protocol.Power(float("nan"), float("nan"), float("nan"), False, 0)
        self._take(self.host.sent("boot 0"))

    def _take(self, data: bytes) -> None:
        for packet in self._decoder.feed(data):
            if packet.type == protocol.PacketType.POWER:
                self._power = protocol.decode_power(packet.payload)
            elif packet.type == protocol.PacketType.ACK:
                answer = protocol.decode_ack(packet.payload)
                self._answers[answer.type] = answer

    def _send(self, type: int, payload: bytes = b"") -> protocol.AckError:
        self._sequence = (self._sequence + 1) % 65536
        self._answers.pop(type, None)
        self._take(self.host.sent(f"wire {encode_packet(Packet(type, payload, self._sequence)).hex()}"))
        return protocol.AckError(self._answers[type].error) if type in self._answers else protocol.AckError.DONE

    def poll(self, now: float) -> None:
        reading = self._circuit.read_power()
        values = (reading.battery, reading.target, reading.output, reading.current, int(reading.closed))
        for name, value in zip(("battery", "target", "output", "current", "feedback"), values, strict=True):
            self.host.command(f"force {name} {value}")
        self._take(self.host.sent(f"advance {round(1e6 * now)}"))
        state = self.host.state()
        self._circuit.drive(Outputs(bool(state["precharge"]), bool(state["coil"]), state["limit"], state["voltage"]))

    def report(self) -> protocol.Power:
        return self._power

    def heartbeat(self, now: float) -> None:
        self._send(protocol.PacketType.HEARTBEAT)

    def close(self, limits: ChargeLimits, now: float) -> protocol.AckError:
        return self._send(protocol.PacketType.CONTACTOR, protocol.encode_close(limits))

    def limit(self, current: float) -> protocol.AckError:
        return self._send(protocol.PacketType.CONTACTOR, protocol.encode_limit(current))

    def open(self, now: float) -> None:
        self._send(protocol.PacketType.CONTACTOR, b"\0")

    def start_probe(self, now: float) -> protocol.AckError:
        self.host.command("probe {} {}".format(*self._circuit.probe()))
        return self._send(protocol.PacketType.PROBE)

    def poll_probe(self, now: float) -> tuple[float, float] | None:
        answer = self._answers.get(protocol.PacketType.PROBE)
        return None if answer is None or answer.error else protocol.decode_probe(answer.data)


class FirmwareCharger(VirtualCharger):
    """A charger in virtual time whose board is the firmware."""

    def _make_power(self) -> Any:
        return FirmwarePower(self.world.circuit, self.world.parameters.stage)


@pytest.mark.parametrize("kind", KINDS)
def test_the_firmware_charges_each_kind_of_target_to_its_right_end(kind: str) -> None:
    case = TargetCase(kind, ROWS[kind], random.Random(kind))
    case.drawn = replace(case.drawn, port=replace(case.drawn.port, capacity=80.0))  # full sooner
    charger = FirmwareCharger(case.world(WorldParameters()), DockingParameters(), profile=case.profile)
    outcome = charger.dock(case.goal(GOAL), LIMIT)
    assert case.judged(charger, outcome)["right"], (outcome, charger.world.record, charger.world.circuit.port.voltage)
    charger.power.host.close()
