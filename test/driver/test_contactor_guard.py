# SPDX-License-Identifier: Apache-2.0
"""The guard of the contactor on the emulated board, in virtual time."""

import contextlib
import math
import threading
from collections.abc import Callable

import pytest

from deltacharger_core.machine import ChargeLimits
from deltacharger_driver.board import protocol, receiver
from deltacharger_driver.board.contactor import ContactorGuard, ContactorLease, LeaseRefused
from deltacharger_driver.errors import NoAnswer
from deltacharger_sim.emulators.board import BoardEmulator

from .board_bench import STEP, Bench, acks

LEASE = 0.25
LIMITS = ChargeLimits(10.0, 29.4)


class Charger:
    """A guard whose link, heartbeat and keeper this is.

    Attributes:
        commands: to the contactor.
        currents: limits told while it is closed.
        on_probe, on_keep_alive: called in between.
    """

    def __init__(self) -> None:
        self.bench, self.until = Bench(), -math.inf
        self.commands, self.currents = list[bool](), list[float]()
        self.board, self.plant = self.bench.board, self.bench.plant
        self.on_probe: Callable[[], object] = lambda: None
        self.on_keep_alive: Callable[[], object] = lambda: None
        self.guard = ContactorGuard(self, clock=lambda: self.bench.now)  # type: ignore[arg-type]
        self._receiver = receiver.BoardReceiver(
            receiver.BoardRequests(), self.guard.observe_tactile, self.guard.observe_power, self.guard.interrupted
        )
        self.bench.send(protocol.PacketType.START)
        self.run(0.1)
        assert self.bench.error(protocol.PacketType.TARE, wait=0.05) == 0
        self.plant.press(20.0)
        self.run(0.2)

    @property
    def is_closed(self) -> bool:
        return self.plant.read_power().closed

    def run(self, seconds: float) -> None:
        """Let time pass: heartbeat, keeper, reports."""
        for _ in range(round(seconds / STEP)):
            self.bench.beating = self.bench.now < self.until
            for packet in self.bench.run(STEP):
                self._receiver.take_packet(packet, self.bench.now)
            if self.guard.remaining() <= 0.0:
                self.guard.tick()

    def close(self, holder: str = "dock", lease: float = LEASE, token: str = "", current: float = 10.0) -> float:
        return self.guard.close(holder, lease, token, LIMITS._replace(current=current))

    def charge(self, seconds: float) -> None:
        """Hold the lease as docking_node does."""
        for _ in range(round(seconds / 0.1)):
            self.close()
            self.run(0.1)

    def keep_alive(self, until: float) -> None:
        self.until = until
        self.bench.send(protocol.PacketType.HEARTBEAT)
        self.on_keep_alive()

    def stop_heartbeat(self) -> None:
        self.until = -math.inf

    def contactor(self, close: bool, limits: ChargeLimits | None = None) -> None:
        self.commands.append(close)
        self._order(b"\0" if limits is None else protocol.encode_close(limits))

    def limit_current(self, current: float) -> None:
        self.currents.append(current)
        self._order(protocol.encode_limit(current))

    def clear_weld(self) -> None:
        self._order(b"\2")

    def _order(self, payload: bytes) -> None:
        error = self.bench.error(protocol.PacketType.CONTACTOR, payload)
        if error:
            raise protocol.CommandRefused(protocol.PacketType.CONTACTOR, error)

    def probe(self) -> protocol.ProbeResult:
        self.on_probe()
        before = len(self.bench.packets)
        self.bench.send(protocol.PacketType.PROBE)
        while not (
            found := [each for each in acks(self.bench.packets[before:]) if each.type == protocol.PacketType.PROBE]
        ):
            self.run(STEP)
        (ack,) = found
        return protocol.ProbeResult(*protocol.decode_probe(ack.data), self.bench.now)


@pytest.fixture
def charger() -> Charger:
    """Ready to close."""
    charger = Charger()
    charger.guard.probe()
    return charger


def test_a_held_lease_charges_and_anyone_ends_it_by_an_open(charger: Charger) -> None:
    charger.run(0.2)
    assert charger.until == -math.inf  # no heartbeat without a lease
    charger.charge(0.6)
    assert charger.is_closed
    assert charger.bench.power().charge_current > 1.0
    assert charger.guard.lease_record()["lease_renewals"] == 5
    charger.guard.open()
    assert not charger.board.contactor_commanded
    assert (charger.guard.remaining(), charger.until) == (math.inf, -math.inf)
    assert math.isinf(charger.guard.probe_record()[1])
    charger.run(0.1)
    assert not charger.is_closed
    assert charger.board.fault == 0
    with pytest.raises(LeaseRefused, match="probe"):
        charger.close()


def test_a_lease_that_is_not_renewed_lapses_in_time_without_a_fault(charger: Charger) -> None:
    charger.charge(0.3)
    charger.close()
    charger.run(LEASE - 2 * STEP)
    assert charger.is_closed
    charger.run(0.05)
    assert not charger.is_closed
    charger.run(0.3)
    assert charger.board.fault == 0
    assert charger.guard.lease_record()["lease_lapses"] == 1
    with pytest.raises(LeaseRefused, match="probe"):
        charger.close()


@pytest.mark.parametrize(
    ("spoil", "wait", "word"),
    [
        (lambda charger: charger.plant.press(0.0), 0.3, "contact"),
        (lambda charger: charger.board.trip(protocol.BoardFault.OVER_CURRENT), 0.06, "over current"),
        (lambda charger: charger.guard.interrupted(), 0.0, "power stage"),
        (lambda charger: charger.guard.shut_down(), 0.0, "shutting down"),
    ],
    ids=["no contact", "fault", "interrupted", "shut"],
)
def test_reasons_to_refuse_a_close(
    charger: Charger, spoil: Callable[[Charger], object], wait: float, word: str
) -> None:
    spoil(charger)
    charger.run(wait)
    fault = charger.board.fault
    with pytest.raises(LeaseRefused, match=word):
        charger.close()
    record = charger.guard.lease_record()
    assert (record["refused_closes"], record["holder"], charger.until) == (1, "", -math.inf)
    assert word in str(record["last_refusal"])
    assert True not in charger.commands
    assert charger.board.fault == fault  # it stays visible


@pytest.mark.parametrize(
    "request_",
    [{"lease": -1.0}, {"lease": 0.0}, {"lease": math.nan}, {"holder": ""}, {"holder": "x" * 65}, {"token": "x" * 65}],
)
def test_impossible_closes_are_refused_and_a_good_one_follows(charger: Charger, request_: dict[str, object]) -> None:
    with pytest.raises(LeaseRefused) as refusal:
        charger.close(**request_)  # type: ignore[arg-type]
    assert len(str(refusal.value)) < 100  # a long name is not quoted
    assert not charger.board.contactor_commanded
    assert charger.close(lease=2.0**31) <= LEASE  # an endless lease is shortened
    assert charger.board.contactor_commanded


def test_only_the_token_renews(charger: Charger) -> None:
    charger.close(token="secret")
    for holder, token in (("dock", ""), ("dock", "guess"), ("other", "secret")):
        with pytest.raises(LeaseRefused, match="'dock'"):
            charger.close(holder, token=token)
    charger.close(token="secret")


def test_a_latched_fault_ends_the_lease_and_only_an_open_clears_it(charger: Charger) -> None:
    charger.charge(0.3)
    charger.board.trip(protocol.BoardFault.REVERSE_CURRENT)
    charger.run(0.06)
    assert (charger.guard.remaining(), charger.until) == (math.inf, -math.inf)
    with pytest.raises(LeaseRefused, match="reverse current"):
        charger.close()
    charger.run(0.4)  # a lapse would have opened by now, which clears the fault
    assert charger.guard.shut_down()  # nor does the end of the driver
    assert charger.board.fault == protocol.BoardFault.REVERSE_CURRENT
    charger.guard.open()
    charger.run(0.1)
    assert charger.bench.power().fault == 0


@pytest.mark.parametrize("forgets", ["open", "reboot", "other board"])
def test_a_weld_forbids_close_and_probe_by_name_until_a_person_clears_it(charger: Charger, forgets: str) -> None:
    charger.charge(0.3)
    charger.plant.welded = True
    charger.guard.open()
    charger.run(0.3)
    if forgets == "open":
        charger.guard.open()
    elif forgets == "reboot":
        charger.board.reboot()
    else:
        charger.guard.interrupted()
        charger.bench.board = BoardEmulator(charger.plant)
        charger.plant.welded = False
    charger.run(0.3)
    assert charger.guard.latched_fault().startswith("latched fault: contactor welded")
    for request in (charger.close, charger.guard.probe):
        with pytest.raises(LeaseRefused, match=r"welded.*clear_weld"):
            request()
    with pytest.raises(LeaseRefused, match="stays latched"):  # the target is still docked
        charger.guard.clear_weld()
    charger.plant.welded, charger.plant.resistance = False, math.inf
    charger.run(0.1)
    charger.guard.clear_weld()
    charger.run(0.1)
    assert charger.guard.latched_fault() == ""
    charger.guard.probe()


def test_an_open_does_not_wait_for_a_probe_and_voids_it(charger: Charger) -> None:
    charger.on_probe = charger.guard.open
    with pytest.raises(LeaseRefused, match="opened"):
        charger.guard.probe()
    assert math.isinf(charger.guard.probe_record()[1])


def test_a_close_waits_for_a_running_probe(charger: Charger) -> None:
    closing = threading.Thread(target=charger.close)

    def begin() -> None:
        closing.start()
        closing.join(0.05)
        assert closing.is_alive()
        assert not charger.commands

    charger.on_probe = begin
    charger.guard.probe()
    closing.join()
    assert charger.commands == [True]


@pytest.mark.parametrize("reboots", [True, False], ids=["the board reboots", "the port vanishes"])
def test_an_interruption_while_charging_ends_the_lease(charger: Charger, reboots: bool) -> None:
    charger.charge(0.3)
    if reboots:
        charger.board.reboot()
        charger.run(0.1)
    else:
        charger.guard.interrupted()
    assert (charger.guard.remaining(), charger.until) == (math.inf, -math.inf)
    charger.run(0.3)
    assert not charger.is_closed
    charger.bench.send(protocol.PacketType.START)
    charger.run(0.2)
    with pytest.raises(LeaseRefused):
        charger.close()


def test_an_opening_during_a_close_refuses_it_and_ends_the_heartbeat(charger: Charger) -> None:
    def trip() -> None:
        charger.board.trip(protocol.BoardFault.OVER_CURRENT)
        charger.run(0.06)
        charger.on_keep_alive = lambda: None

    charger.charge(0.3)
    charger.on_keep_alive = trip
    with pytest.raises(LeaseRefused, match="opened"):
        charger.close()
    assert charger.until == -math.inf


def test_a_close_without_an_answer_is_followed_by_an_open(charger: Charger, monkeypatch: pytest.MonkeyPatch) -> None:
    switch = charger.contactor

    def lost(close: bool, limits: ChargeLimits | None = None) -> None:
        switch(close, limits)
        raise NoAnswer("board", "CONTACTOR", 0.2)

    monkeypatch.setattr(charger, "contactor", lost)
    with pytest.raises(NoAnswer):
        charger.close()
    assert charger.commands == [True, False]
    assert not charger.board.contactor_commanded
    assert (charger.guard.remaining(), charger.until) == (math.inf, -math.inf)


def test_a_renewal_tells_the_board_only_another_current_and_only_once_closed(charger: Charger) -> None:
    charger.close(current=10.0)
    charger.close(current=4.0)  # the contactor is still about to close
    assert charger.currents == []
    charger.run(0.1)
    assert charger.is_closed
    for current in (4.0, 4.0, 0.0, 6.0):
        charger.close(current=current)
    assert charger.currents == [4.0, 6.0]
    with pytest.raises(LeaseRefused, match=r"current is 31: give 0\.05 to 30"):
        charger.close(current=31.0)
    assert charger.commands == [True]


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        (None, "current_max"),
        (ChargeLimits(0.0, 0.0, start_time=0.0, gap_time=0.0), r"current is 0: give 0\.05 to 30"),  # an old client's
        (LIMITS._replace(voltage=math.nan), "voltage is nan"),
        (LIMITS._replace(gap_time=131.0), "gap_time is 131"),
    ],
)
def test_a_close_without_valid_limits_is_refused_by_name(limits: ChargeLimits | None, reason: str) -> None:
    lease = ContactorLease()
    lease.probed(math.nan, 24.0, 0.0)
    with pytest.raises(LeaseRefused, match=reason):
        lease.grant("dock", LEASE, 0.1, limits=limits)


@pytest.mark.parametrize(
    ("resistance", "voltage", "live", "dead"),
    [
        (math.nan, 24.0, True, True),
        (math.inf, 0.0, False, True),
        (10_000.0, 0.0, False, True),
        (0.05, 0.0, False, False),
        (math.nan, -24.0, False, False),
        (math.nan, math.nan, False, False),
    ],
    ids=["live", "open", "dead", "short", "reversed", "unknown"],
)
def test_a_close_needs_the_port_that_its_limits_expect(
    resistance: float, voltage: float, live: bool, dead: bool
) -> None:
    for expects_dead, allowed in ((False, live), (True, dead)):
        lease = ContactorLease()
        lease.probed(resistance, voltage, 0.0)
        with contextlib.nullcontext() if allowed else pytest.raises(LeaseRefused):
            lease.grant("dock", LEASE, 0.1, limits=LIMITS._replace(dead=expects_dead))
