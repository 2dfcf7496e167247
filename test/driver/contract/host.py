# SPDX-License-Identifier: Apache-2.0
"""The host's end of a board: the driver's link and guard, with all received data."""

import time

from deltacharger_driver.board import contactor, link, protocol

from ...waiting import wait_until


class BoardHost:
    """A link, a guard and the received data.

    Attributes:
        frames: tactile frames since the last `stream`.
        arrivals: when each of them reached the callback, s, monotonic.
        powers: readings of the power stage since the beginning.
    """

    def __init__(self, path: str) -> None:
        self.frames: list[protocol.TactileSample] = []
        self.arrivals: list[float] = []
        self.powers: list[protocol.PowerSample] = []
        self.link = link.BoardLink(path, on_tactile=self._take_tactile, on_power=self._take_power)
        self.guard = contactor.ContactorGuard(self.link)

    def _take_tactile(self, sample: protocol.TactileSample) -> None:
        self.arrivals.append(time.monotonic())
        self.frames.append(sample)
        self.guard.observe_tactile(sample)

    def _take_power(self, sample: protocol.PowerSample) -> None:
        self.powers.append(sample)
        self.guard.observe_power(sample)

    def settle(self) -> None:
        """Bring the board to its state after a boot, except for the tare."""
        self.link.stop_heartbeat()
        self.link.contactor(False)
        self.link.stop()
        self.link.set_rate(protocol.DEFAULT_RATE)
        self.frames.clear()
        self.arrivals.clear()

    def stream(self, count: int) -> list[protocol.TactileSample]:
        """Stream until `count` frames have arrived, and return all frames up to STOP."""
        self.frames.clear()
        self.arrivals.clear()
        self.link.start()
        wait_until(lambda: len(self.frames) >= count, f"{count} tactile frames")
        self.link.stop()
        return list(self.frames)

    def next_powers(self, count: int) -> list[protocol.PowerSample]:
        """Wait for the next `count` readings of the power stage."""
        first = len(self.powers)
        wait_until(lambda: len(self.powers) >= first + count, f"{count} POWER packets")
        return self.powers[first : first + count]

    def await_contactor(self, closed: bool) -> protocol.PowerSample:
        """Wait until the power stage reports its contactor closed, or open."""
        first = len(self.powers)

        def seen() -> protocol.PowerSample | None:
            return next((s for s in self.powers[first:] if s.power.contactor_closed == closed), None)

        sample = wait_until(seen, f"the contactor to be {'closed' if closed else 'open'}")
        assert sample is not None
        return sample
