# SPDX-License-Identifier: Apache-2.0
"""The mocked power obeys the law of leases that the layers above rely on."""

import pytest

from deltacharger_core import machine
from deltacharger_driver.board.contactor import LeaseRefused
from deltacharger_sim.mocks.mock_tactile_node import CHARGE_CURRENT, MockPower

pytestmark = pytest.mark.ros

LIMITS = machine.ChargeLimits(10.0, 29.4)


def test_current_flows_only_while_leased_and_in_contact() -> None:
    power = MockPower()
    power.advance(0.0, True)
    power.probe(0.0, True)
    power.close("docking", 0.25, 0.0, limits=LIMITS)
    power.advance(0.2, True)
    assert 0.0 < power.current < CHARGE_CURRENT
    power.advance(0.24, False)
    assert power.current == 0.0
    power.advance(0.249, True)
    assert power.closed
    power.advance(0.251, True)
    assert not power.closed
    with pytest.raises(LeaseRefused, match="probe"):
        power.close("docking", 0.25, 0.26, limits=LIMITS)
