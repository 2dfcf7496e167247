# SPDX-License-Identifier: Apache-2.0
"""Log lines of a mission: one for each stage and each failure."""

from __future__ import annotations

from deltacharger_core.texts import passage
from deltacharger_docking.codes import Code
from deltacharger_mission.dialogue import MissionStatus, Stage


class StageLog:
    """Turns changes of the machine into log lines."""

    def __init__(self) -> None:
        self.begin("mission")

    def begin(self, title: str) -> None:
        """Set the title of a mission that begins."""
        self._title = title
        self._stage, self._entered = Stage.WAIT, 0.0
        self._code = Code.NONE

    def lines(self, status: MissionStatus) -> list[str]:
        """Return the lines for what changed."""
        failed = status.code and status.code is not self._code
        self._code = status.code
        news = [f"{int(status.code)} {status.code.name}: {status.message}"] if failed else []
        if status.stage is self._stage:
            return [f"{self._title}: {status.stage.name.lower()}, {news[0]}"] if news else []
        lasted = status.elapsed - self._entered
        line = passage(self._title, self._stage.name, status.stage.name, lasted, *news, *_where(status))
        self._stage, self._entered = status.stage, status.elapsed
        return [line]


def _where(status: MissionStatus) -> list[str]:
    """Return the base's place, the number of views and of moves to a better place, as text."""
    place = status.place
    at = (
        [] if place is None else [f"base at ({place.x:.2f}, {place.y:.2f}) m, yaw {place.yaw:.2f} rad of {place.frame}"]
    )
    counts = (("views", status.views), ("moves", status.moves))
    return at + [f"{name} {count}" for name, count in counts if count]
