# SPDX-License-Identifier: Apache-2.0
"""The pseudo-terminal of an emulated device: links, unplugging, and a device that runs without its host."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import serial

from deltacharger_driver.emulators.bench_plant import BenchPlant
from deltacharger_driver.emulators.pads import EmulatedPads
from deltacharger_driver.pseudo_terminal import PseudoTerminal
from deltacharger_tactile.source import ContactSource

from ..waiting import wait_until


class Echo:
    """Returns received bytes and counts its polls."""

    def __init__(self) -> None:
        self.polled = 0

    def receive(self, data: bytes, now: float) -> bytes:
        return data

    def poll(self, now: float) -> bytes:
        self.polled += 1
        return b""

    def next_event(self, now: float) -> float:
        return 0.005


def test_an_unplugged_device_keeps_working_and_is_found_again_by_its_link(tmp_path: Path) -> None:
    device = Echo()
    with PseudoTerminal(device, tmp_path / "port") as cable:
        cable.unplug()
        assert not os.path.lexists(cable.path)
        before = device.polled
        wait_until(lambda: device.polled > before + 5)
        cable.replug()
        with serial.Serial(cable.path, timeout=5.0) as port:
            port.write(b"hello")
            assert port.read(5) == b"hello"


def test_it_returns_the_speed_set_by_its_host(tmp_path: Path) -> None:
    with PseudoTerminal(Echo(), tmp_path / "port") as cable:
        for speed in (9600, 57600, 1_000_000, 4_000_000):
            with serial.Serial(cable.path, speed):
                assert cable.speed() == speed
        with serial.Serial(cable.path, 38400):  # of no servo
            assert cable.speed() == 0
        cable.unplug()
        assert cable.speed() == 0
    assert cable.speed() == 0


def test_a_second_terminal_on_the_same_link_keeps_it_when_the_first_ends(tmp_path: Path) -> None:
    first = PseudoTerminal(Echo(), tmp_path / "port").start()
    second = PseudoTerminal(Echo(), tmp_path / "port").start()
    first.stop()
    assert os.path.exists(tmp_path / "port")
    second.stop()
    assert not os.path.lexists(tmp_path / "port")


@pytest.mark.parametrize("rig", [0, 25, 45])
def test_every_rig_can_be_tared_in_free_air(rig: int) -> None:
    source = ContactSource(None, rig_seed=rig, seed=rig)
    plant = BenchPlant()
    moment = iter(np.arange(0.0, 10.0, 0.004))
    plant.read_taxels = lambda: source.sample(float(next(moment)), None, 0.0)  # type: ignore[method-assign]
    for _ in range(5):
        pads = EmulatedPads(plant)
        pads.start_tare(0.0)
        pads.poll_tare(1.0)
        assert pads.tared
