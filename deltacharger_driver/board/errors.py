# SPDX-License-Identifier: Apache-2.0
"""What a board can refuse, beside what a port can do (errors.py)."""

from __future__ import annotations

from deltacharger_driver.board.protocol import VERSION, AckError, type_name
from deltacharger_driver.errors import DriverError

_EXPLANATIONS = {
    AckError.BAD_PAYLOAD: "it did not understand the value",
    AckError.UNKNOWN: "it does not know this command; update the board's firmware",
    AckError.INTERLOCK: (
        "interlock: a close needs a live heartbeat, no latched fault and a probe younger than 2 s "
        "without a short, reversal or open circuit; open, then probe, then close"
    ),
    AckError.NOT_NOW: "not now",
}


class CommandRefused(DriverError, RuntimeError):
    """The board answered a command with an error. Example: a tare while something touches the pads.

    Args:
        type: number of the command's packet type.
        error: number of the error, see `AckError`.
        advice: what it means for this command.
        attempts: how often it was sent; an earlier attempt may have been carried out.
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
    """The board booted while it was asked; what was asked is lost. Example: its supply dipped.

    Args:
        action: what was asked of it.
    """

    def __init__(self, action: str) -> None:
        self.action = action
        super().__init__(f"the board rebooted during {action}; it forgot tare, probe and contactor: ask again")


class BoardMismatch(DriverError, ConnectionError):
    """The board is not one this driver can use. Example: firmware of another protocol version.

    Args:
        port: path of the port.
        reason: what differs.
    """

    def __init__(self, port: str, reason: str) -> None:
        self.port = port
        self.reason = reason
        super().__init__(f"{port}: {reason}; this driver needs version {VERSION} and 10 x 10 taxels")
