# SPDX-License-Identifier: Apache-2.0
"""Helpers that make and filter findings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from deltacharger_bringup.doctor.findings import Finding
from deltacharger_bringup.doctor.servos import examine_servos

from ...emulated_ports import IDS

LIKELY = (1_000_000, 57600)
"""Speeds to search if the others do not matter: each takes 0.2 s or more."""


def servo_findings(port: str, speeds: Sequence[int] = LIKELY) -> list[Finding]:
    return list(examine_servos(port, 1_000_000, IDS, 3.0, speeds))


def only(findings: Iterable[Finding], level: str) -> list[Finding]:
    return [finding for finding in findings if finding.level == level]


def one(findings: Iterable[Finding], level: str, part: str) -> Finding:
    matching = [finding for finding in findings if (finding.level, finding.part) == (level, part)]
    assert len(matching) == 1, list(findings)
    return matching[0]
