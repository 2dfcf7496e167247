"""Steps 5 and 6 of Algorithm 1: measure the misalignment, judge it, move, and press again."""

from __future__ import annotations

import math

from deltacharger_docking.alignment import AlignmentFilter
from deltacharger_docking.clearance import Estimate, Verdict, judge
from deltacharger_docking.codes import CriticalAngle, EstimateUnsure, Misaligned, NoTactileContact, State, TactileStale
from deltacharger_docking.contact_script import contact
from deltacharger_docking.context import Context, Script
from deltacharger_docking.observation import Service

_SAME_PLACE_MAX = 2  # dockings at one offset whose estimate stays unsure
_UNSURE_MAX = 4  # unsure estimates in all
_WORTH_MOVING = 0.002  # m; a smaller offset is no reason for a pad to lose its ridge
_ESTIMATE_TIMEOUT = 3.0  # s


class Alignment:
    """The loop of measuring and moving. One instance serves one goal."""

    def __init__(self, context: Context, critical_angle: float, depth: float) -> None:
        self._context = context
        self._critical_angle = critical_angle
        self._depth = depth
        parameters = context.parameters
        self._filter = AlignmentFilter(parameters.docking_jitter, parameters.gain_error)
        self._angles: list[float] = []
        self._unsure = self._unsure_here = 0
        self._passed = 0
        self.aligned = False

    def run(self) -> Script[None]:
        """Align until the estimate allows current to flow.

        Raises:
            CriticalAngle: the target is tilted too far.
            Misaligned: clearance was not reached within the allowed alignments.
            EstimateUnsure: the estimate stayed unsure.
            NoTactileContact: the pads feel nothing.
        """
        context, parameters = self._context, self._context.parameters
        while True:
            estimate = yield from self._measure()
            if not (estimate.sure and estimate.in_range and estimate.complete):
                self._passed = 0
                yield from self._dock_again(*self._look_elsewhere(estimate))
                continue
            self._unsure_here = 0
            place = context.position[0], context.position[1]
            self._filter.update(place, estimate)
            verdict = self._judge(estimate)
            x, y = self._filter.misalignment(place)
            self.aligned = max(abs(x), abs(y)) <= parameters.alignment_tolerance
            exhausted = context.status.alignments >= parameters.alignments_max
            settled = self.aligned or (exhausted and parameters.charge_when_not_aligned)
            safe = verdict is Verdict.SAFE or (verdict is Verdict.PROBABLY_SAFE and self._passed >= 2)
            if settled and safe:
                return
            if exhausted:
                raise Misaligned(
                    f"after {context.status.alignments} alignments the electrodes are still "
                    f"{1000 * x:.1f} mm horizontally and {1000 * y:.1f} mm vertically off"
                )
            context.status.alignments += 1
            yield from self._dock_again(*((0.0, 0.0) if self.aligned else (x, y)))

    def _measure(self) -> Script[Estimate]:
        """Return what the pads feel, sure or not.

        Raises:
            NoTactileContact: they feel nothing.
            TactileStale: no estimate came.
        """
        context = self._context
        context.enter(State.MEASURE, context.parameters.measure_timeout)
        reply = yield from context.ask(
            Service.ESTIMATE, TactileStale, _ESTIMATE_TIMEOUT, context.parameters.estimate_frames
        )
        if not reply.success or reply.estimate is None:
            raise TactileStale(f"no misalignment estimate: {reply.message}")
        context.status.estimate = reply.estimate
        if not reply.estimate.contact:
            raise NoTactileContact("the pads lost contact before the misalignment was measured")
        return reply.estimate

    def _look_elsewhere(self, estimate: Estimate) -> tuple[float, float]:
        """Return by how much (m) to move before measuring again: where an unsure estimate points, or nowhere.

        A pad that has lost its ridge still tells the direction. It only moves the arm; energising needs a sure one.
        """
        self._unsure_here += 1
        self._unsure += 1
        place = self._context.position
        x, y = estimate.horizontal, estimate.vertical
        lost = estimate.complete and not estimate.in_range and math.hypot(x, y) > _WORTH_MOVING
        reachable = lost and not self._context.planner.reachable((place[0] + x, place[1] + y, place[2]))
        if reachable and self._unsure < _UNSURE_MAX:
            self._unsure_here = 0
            self._context.status.alignments += 1
            return x, y
        if self._unsure_here >= _SAME_PLACE_MAX or self._unsure >= _UNSURE_MAX:
            self._give_up(estimate)
        return 0.0, 0.0

    def _give_up(self, estimate: Estimate) -> None:
        limit = min(self._critical_angle, self._context.parameters.critical_angle)
        if math.isfinite(estimate.angle) and abs(estimate.angle) >= limit:
            raise CriticalAngle(_too_tilted(estimate.angle))
        what = "outside what the estimator knows" if not estimate.in_range else "unsure"
        raise EstimateUnsure(f"the tactile estimate stayed {what} after {self._unsure} dockings; check pads and target")

    def _judge(self, estimate: Estimate) -> Verdict:
        """Judge this docking, and the mean angle once two have been made."""
        parameters = self._context.parameters
        self._angles.append(estimate.angle)
        verdict = judge(estimate, parameters, self._critical_angle)
        self._passed = self._passed + 1 if verdict in (Verdict.SAFE, Verdict.PROBABLY_SAFE) else 0
        if len(self._angles) >= 2:
            mean = sum(self._angles) / len(self._angles)
            centred = Estimate(
                mean, estimate.angle_stddev, 0.0, estimate.vertical_stddev, 0.0, estimate.horizontal_stddev
            )
            if judge(centred, parameters, self._critical_angle) is Verdict.CRITICAL:
                raise CriticalAngle(_too_tilted(mean))
        return verdict

    def _dock_again(self, x: float, y: float) -> Script[None]:
        """Lift off, move the command by (x, y) m and press again.

        The command moves by what the measured pose is off, so that friction and a soft servo, which keep the platform
        short of its command, are corrected as well.

        Raises:
            Unreachable: the way there leaves the arm's reach; the platform was not lifted.
        """
        context, parameters = self._context, self._context.parameters
        commanded, z = context.commanded, context.position[2]
        place = commanded[0] + x, commanded[1] + y, z - parameters.lift
        context.check_way((*context.position[:2], place[2]), place, (*place[:2], z))
        context.enter(State.ALIGN, parameters.align_timeout)
        yield from context.release()
        yield from context.move((*context.position[:2], place[2]), parameters.travel_speed, settle=False)
        yield from context.move(place, parameters.travel_speed)
        yield from contact(context, self._depth)


def _too_tilted(angle: float) -> str:
    return (
        f"the target is tilted by {math.degrees(angle):.1f}°: the electrodes would come too close to a short; "
        "level the target or the charger"
    )
