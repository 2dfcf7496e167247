# SPDX-License-Identifier: Apache-2.0
"""The lease on the contactor: one holder, 0.25 s at most, and every opening resets it."""

from __future__ import annotations

import math

import pytest

from deltacharger_driver.board.contactor_lease import ContactorLease, LeaseRefused


def probed(now: float = 0.0, resistance: float = 25.0, voltage: float = 24.0) -> ContactorLease:
    lease = ContactorLease()
    lease.probed(resistance, voltage, now)
    return lease


def test_a_holder_without_name_is_refused() -> None:
    with pytest.raises(LeaseRefused, match="name"):
        probed().take("", 0.2, 0.0)


def test_the_holder_renews_without_a_new_probe() -> None:
    lease = probed()
    now = 0.0
    for _ in range(100):
        now = lease.take("dock", 0.25, now) - 0.01
    assert now > 20.0
    assert lease.is_live(now)
    assert lease.renewals == 99  # the first of the hundred was the close


def test_another_holder_cannot_close() -> None:
    lease = probed()
    lease.take("dock", 0.25, 0.0)
    with pytest.raises(LeaseRefused, match="'dock' holds"):
        lease.take("other", 0.25, 0.1)
    assert lease.holder == "dock"


def test_an_opening_clears_the_token() -> None:
    lease = probed()
    lease.take("dock", 0.25, 0.0, "secret")
    lease.opened()
    lease.probed(25.0, 24.0, 0.2)
    lease.take("dock", 0.25, 0.3, "another")
    lease.take("dock", 0.25, 0.4, "another")


@pytest.mark.parametrize("names", [("x" * 65, ""), ("dock", "x" * 65), ("dock", "é" * 5_000_000)])
def test_too_long_names_are_refused_and_not_quoted(names: tuple[str, str]) -> None:
    lease = probed()
    with pytest.raises(LeaseRefused, match="at most 64") as refusal:
        lease.take(names[0], 0.25, 0.0, names[1])
    assert len(str(refusal.value)) < 100
    assert not lease.is_live(0.0)


def test_a_lapsed_lease_refuses_all_until_opened() -> None:
    lease = probed()
    lease.take("dock", 0.25, 0.0)
    assert not lease.has_lapsed(0.249)
    assert lease.has_lapsed(0.25)
    assert not lease.is_live(0.25)
    for holder in ("dock", "other"):
        with pytest.raises(LeaseRefused, match="lapsed"):
            lease.take(holder, 0.25, 0.3)
    lease.opened()
    assert not lease.has_lapsed(0.4)


def test_every_opening_voids_the_probe_and_the_lease() -> None:
    lease = probed()
    lease.take("dock", 0.25, 0.0)
    lease.opened()
    assert lease.holder == ""
    assert lease.openings == 1
    assert math.isinf(lease.probe_age(0.1))
    assert lease.resistance == 25.0  # still known, but void
    with pytest.raises(LeaseRefused, match="since the last opening"):
        lease.take("dock", 0.25, 0.1)
    lease.probed(25.0, 24.0, 0.2)
    lease.take("other", 0.25, 0.3)
