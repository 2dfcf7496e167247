# SPDX-License-Identifier: Apache-2.0
"""Errors of the board, in addition to those of a port (errors.py)."""

from __future__ import annotations

from deltacharger_driver.board.protocol import MINOR, VERSION, AckError, type_name
from deltacharger_driver.errors import DriverError

_EXPLANATIONS = {
    AckError.BAD_PAYLOAD: "invalid value",
    AckError.UNKNOWN: "unknown command; update the board's firmware",
    AckError.INTERLOCK: (
        "interlock: a close needs a live heartbeat, no latched fault, a probe younger than 2 s that found a port as "
        "the limits expect it, and a stage whose voltage they allow; open, then probe, then close"
    ),
    AckError.NOT_NOW: "not possible now",
}


class CommandRefused(DriverError, RuntimeError):
    """The board answered a command with an error. Example: a tare while something touches the pads.

    Args:
        type: number of the command's packet type.
        error: number of the error, see `AckError`.
        advice: explanation for this command; replaces the default one.
        attempts: how often the command was sent; an earlier attempt may have been executed.
    """

    def __init__(self, type: int, error: int, advice: str = "", attempts: int = 1) -> None:
        self.type = type
        self.error = error
        self.attempts = attempts
        try:
            reason = _EXPLANATIONS.get(AckError(error), f"error {error}")
        except ValueError:
            reason = f"error {error}"
        super().__init__(f"the board refused {type_name(type)}: {advice or reason}")


class BoardRebooted(DriverError, ConnectionResetError):
    """The board rebooted while a command was pending; the command is lost. Example: its supply dipped.

    Args:
        action: the command.
    """

    def __init__(self, action: str) -> None:
        self.action = action
        super().__init__(
            f"the board rebooted during {action}; tare and probe are lost, the contactor is open; repeat the command"
        )


class BoardMismatch(DriverError, ConnectionError):
    """This driver cannot use the board. Example: firmware of another protocol version.

    Args:
        port: path of the port.
        reason: what differs.
    """

    def __init__(self, port: str, reason: str) -> None:
        self.port = port
        self.reason = reason
        needs = f"this driver needs version {VERSION}.{MINOR} or later and 10 x 10 taxels"
        super().__init__(f"{port}: {reason}; {needs}: flash the current firmware")
