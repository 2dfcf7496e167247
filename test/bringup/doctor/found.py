# SPDX-License-Identifier: Apache-2.0
"""Findings: made, and looked through."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from deltacharger_bringup.doctor.findings import Finding
from deltacharger_bringup.doctor.servos import examine_servos

from ...emulated_ports import IDS

LIKELY = (1_000_000, 57600)
"""Speeds to look at where the others are no matter of the test: each takes a fifth of a second or more."""


def servo_findings(port: str, speeds: Sequence[int] = LIKELY) -> list[Finding]:
    return list(examine_servos(port, 1_000_000, IDS, 3.0, speeds))


def only(findings: Iterable[Finding], level: str) -> list[Finding]:
    return [finding for finding in findings if finding.level == level]


def one(findings: Iterable[Finding], level: str, part: str) -> Finding:
    matching = [finding for finding in findings if (finding.level, finding.part) == (level, part)]
    assert len(matching) == 1, list(findings)
    return matching[0]
