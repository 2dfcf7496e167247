# SPDX-License-Identifier: Apache-2.0
"""The goal that is being served: when it began, until when it must have ended, and how it ended."""

from __future__ import annotations

import math
from dataclasses import replace

from deltacharger_docking.codes import Code, DockingError
from deltacharger_docking.context import Context
from deltacharger_docking.goal_check import suggested_base
from deltacharger_docking.observation import DockingOutcome, Observation


class GoalDesk:
    """Takes one goal at a time and hands out its outcome.

    Attributes:
        is_open: whether a goal is being served.
        started: when it began, s.
        deadline: when it must have ended, s.
        wants_back: whether its client has taken it back.
        aligned: whether its docking has come within the tolerance.
        outcome: of the last goal, until the shell has taken it.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self.is_open = False
        self.started = 0.0
        self.deadline = math.inf
        self.wants_back = False
        self.aligned = False
        self.outcome: DockingOutcome | None = None

    def begin(self, request_id: str, observation: Observation) -> None:
        """Take a goal."""
        context = self._context
        context.observe(observation)
        self.is_open, self.wants_back, self.aligned, self.outcome = True, False, False, None
        self.started = context.time
        self.renew()
        context.energy = 0.0
        context.deadline = math.inf
        context.status.request_id = request_id
        context.status.code, context.status.message = Code.NONE, ""

    def renew(self) -> None:
        """Give the whole of `goal_timeout` from now on."""
        self.deadline = self._context.time + self._context.parameters.goal_timeout

    def succeed(self, message: str) -> None:
        """End the goal with success, if there is one."""
        self._end(self._outcome(True, Code.NONE, message, False))

    def fail(self, error: DockingError) -> None:
        """End the goal with the code of `error` and the message of the status, if there is one."""
        outcome = self._outcome(False, error.code, self._context.status.message, error.retriable)
        self._end(replace(outcome, suggested_base=suggested_base(error)))

    def _outcome(self, success: bool, code: Code, message: str, retriable: bool) -> DockingOutcome:
        context = self._context
        return DockingOutcome(
            success=success,
            code=code,
            message=message,
            retriable=retriable,
            aligned=self.aligned,
            alignments=context.status.alignments,
            estimate=context.status.estimate,
            contact_current=context.contact.value,
            contact_force=context.contact.force,
            charge_current=context.observation.charge_current,
            energy=context.energy,
            elapsed=context.time - self.started,
        )

    def _end(self, outcome: DockingOutcome) -> None:
        if not self.is_open:
            return
        self.is_open, self.wants_back, self.deadline, self.outcome = False, False, math.inf, outcome
        text = outcome.message if outcome.success else f"{outcome.code.name}: {outcome.message}"
        self._context.decide("ended", text, code=outcome.code, elapsed_s=outcome.elapsed, energy_J=outcome.energy)
