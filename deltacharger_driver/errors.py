# SPDX-License-Identifier: Apache-2.0
"""Errors of the driver. All derive from `DriverError`, carry their values and state what to do."""

from collections.abc import Sequence

MAYBE_SWAPPED = "whether the cables of servos and board are swapped: 'deltacharger doctor' tells which port is which"
"""About a port on which the expected device does not answer."""


class DriverError(Exception):
    """Root of every error raised by deltacharger_driver."""


class PortError(DriverError, ConnectionError):
    """A serial port cannot be used.

    Args:
        port: path of the port.
        reason: the operating system's message; may be empty.
    """

    what = "cannot use the port"
    advice = "check the cable and the parameter 'port'"

    def __init__(self, port: str, reason: str = "") -> None:
        self.port = port
        self.reason = reason
        super().__init__(f"{port}: {self.what}{f' ({reason})' if reason else ''}; {self.advice}")


class PortMissing(PortError, FileNotFoundError):
    """No port of this name exists. Example: the adapter enumerated as ttyUSB1."""

    what = "there is no such port"
    advice = "plug the adapter in or correct the parameter 'port'"


class NoServosBehindBoard(PortMissing):
    """tactile_node provides no servo port. Example: the board's firmware is older than 1.1."""

    what = "there are no servos behind the board"
    advice = (
        "flash firmware with SERVOS_ON_BOARD and start tactile_node in this namespace; its log names the servo port"
    )


class PortNotSerial(PortError):
    """The path is not a serial port. Example: a directory, a file, /dev/null."""

    what = "this is not a serial port"
    advice = "set the parameter 'port' to a serial device, such as one in /dev/serial/by-id"


class PortGone(PortError):
    """The port was open and vanished. Example: the USB cable was pulled while the bus ran."""

    what = "the port disappeared"
    advice = "plug the cable back in; the driver reopens the port; the torque stays off and the contactor open"


class PortBusy(PortError):
    """Another process owns the port. Example: a second driver, or the servo vendor's tool.

    Args:
        port: path of the port.
        reason: names of the programs; empty if they are another user's.
    """

    what = "the port is in use by another program"
    advice = "close the other program (sudo lsof names it)"


class PortDenied(PortError, PermissionError):
    """The user may not open the port. Example: not a member of the group dialout."""

    what = "permission denied"
    advice = "add the user to the group that owns the port, usually dialout, and log in again"


class NoAnswer(DriverError, TimeoutError):
    """A device did not answer in time. Example: a servo lost its supply.

    Args:
        device: that did not answer.
        action: the request.
        timeout: total time waited, s.
    """

    def __init__(self, device: str, action: str, timeout: float) -> None:
        check = f"check its supply and its cable, and {MAYBE_SWAPPED}"
        super().__init__(f"{device}: no answer to {action} within {timeout * 1e3:.0f} ms; {check}")


class CorruptReply(DriverError, ConnectionError):
    """A device sent an invalid reply. Example: a bad checksum, a wrong length.

    Args:
        device: that sent it.
        action: the request.
        reason: what is wrong with the reply.
    """

    def __init__(self, device: str, action: str, reason: str) -> None:
        super().__init__(f"{device}: invalid reply to {action}: {reason}; look for noise, a bad plug or a duplicate id")


class HandshakeError(DriverError, ConnectionError):
    """The servos found are not the expected ones. Example: id 2 missing and id 3 at another speed.

    Args:
        port: path of the port.
        faults: every fault found, one sentence each.
    """

    def __init__(self, port: str, faults: Sequence[str]) -> None:
        self.faults = tuple(faults)
        super().__init__(f"{port}: " + "; ".join(faults))


class ServoFault(DriverError, RuntimeError):
    """A servo rejected an instruction or reports a hardware error. Example: overload after a jam.

    Args:
        servo: id of the servo.
        action: the request.
        fault: the error in words.
    """

    def __init__(self, servo: int, action: str, fault: str) -> None:
        super().__init__(f"servo {servo}: {action}: {fault}")


class RangeError(DriverError, ValueError):
    """A value lies outside what the hardware can represent.

    Args:
        name: of the value.
        value: the rejected value.
        low: smallest allowed value.
        high: largest allowed value.
        unit: unit of all three.
    """

    def __init__(self, name: str, value: float, low: float, high: float, unit: str = "") -> None:
        self.name = name
        super().__init__(f"{name} = {value:g}{unit} is outside {low:g}…{high:g}{unit}")


class TrajectoryRefused(DriverError, ValueError):
    """A joint trajectory is refused; nothing moves. Example: an angle beyond its limit.

    Args:
        reason: what is wrong with it.
    """

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"trajectory refused: {reason}")
