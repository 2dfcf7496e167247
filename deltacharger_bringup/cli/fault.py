# SPDX-License-Identifier: Apache-2.0
"""`deltacharger fault`: inject faults into the emulated hardware of a running charger."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from deltacharger_bringup.cli.charger import require_domain
from deltacharger_bringup.cli.output import DONE, WRONG_INPUT, CommandError, print_result, print_text, write_json
from deltacharger_bringup.cli.parser import namespace_option
from deltacharger_bringup.cli.types import NOT_NEGATIVE, between, integer
from deltacharger_core import environment, runtime
from deltacharger_core.parameters import ParameterError
from deltacharger_sim.charger.fault_channel import SOCKET, ask
from deltacharger_sim.charger.fault_kinds import KINDS, Kind
from deltacharger_sim.charger.faults import Fault

_FLAGS = {"last": "--for-s", "servo": "--servo", "amount": "--amount"}


def add_fault(parser: argparse.ArgumentParser) -> None:
    """Add the options of `fault`."""
    parser.add_argument("kind", nargs="?", metavar="KIND", help="kind of fault; see --list")
    parser.add_argument("--for-s", type=NOT_NEGATIVE, default=0.0, metavar="S", help="duration (until --clear)")
    parser.add_argument("--amount", type=between(-1e9, 1e9), metavar="A", help="size, in the unit of its kind")
    parser.add_argument("--servo", type=integer(1, 3), default=0, metavar="N", help="id, for faults of one servo")
    parser.add_argument("--list", action="store_true", help="list the kinds and the active faults")
    parser.add_argument("--clear", action="store_true", help="end all lasting faults")
    parser.add_argument("--directory", metavar="DIR", help="folder of the ports (default: by ROS domain)")
    namespace_option(parser)


def fault(options: argparse.Namespace) -> int:
    """Inject one fault, end all, or list them."""
    if (options.kind is not None) + options.list + options.clear != 1:
        raise CommandError("give exactly one of KIND, --list and --clear", WRONG_INPUT)
    require_domain()
    if options.kind is not None:
        return _inject(options, _checked(options))
    if options.amount is not None or options.servo or options.for_s:
        raise CommandError("--amount, --servo and --for-s need a KIND", WRONG_INPUT)
    return _clear(options) if options.clear else _list(options)


def _checked(options: argparse.Namespace) -> Fault:
    try:
        return Fault(options.kind, last=options.for_s, servo=options.servo, amount=options.amount)
    except ParameterError as error:
        flag = _FLAGS.get(error.key)
        raise CommandError(f"{flag}: {error.problem}" if flag else error.problem, WRONG_INPUT) from error


def _inject(options: argparse.Namespace, wanted: Fault) -> int:
    request: dict[str, Any] = {"command": "begin", "kind": wanted.kind, "last": wanted.last, "servo": wanted.servo}
    if wanted.amount is not None:
        request["amount"] = wanted.amount
    reply = _ask(options, request)
    kind = KINDS[wanted.kind]
    injected = {
        "kind": wanted.kind,
        "servo": wanted.whom or None,
        "amount": wanted.how_much if kind.amount else None,
        "for_s": wanted.last or None,
    }
    text = f"{_named(injected)}: {kind.text}{_until(wanted, kind)}"
    print_result(options, text, {"success": True, **injected, "active": reply["active"]})
    return DONE


def _until(wanted: Fault, kind: Kind) -> str:
    if not kind.lasts:
        return ""
    return f", for {wanted.last:g} s" if wanted.last else ", until --clear"


def _clear(options: argparse.Namespace) -> int:
    reply = _ask(options, {"command": "clear"})
    text = "no faults are active; latched errors of servos and board stay until they are cleared"
    print_result(options, text, {"success": True, "active": reply["active"]})
    return DONE


def _list(options: argparse.Namespace) -> int:
    try:
        active = _ask(options, {"command": "active"})["active"]
    except CommandError:
        active = None
    if options.json:
        write_json({"success": True, "kinds": [_described(name) for name in KINDS], "active": active})
        return DONE
    for name, kind in KINDS.items():
        amount = f"; amount: {kind.amount.name}, usually {kind.amount.default:g}" if kind.amount else ""
        servo = {"one": "; --servo, usually 2", "some": "; --servo, usually all"}.get(kind.servo, "")
        print_text(f"{name:20} {kind.text}{amount}{servo}{'' if kind.lasts else '; momentary'}")
    if active is None:
        print_text(f"\n{_none_runs(options)}")
    else:
        print_text("\nactive: " + ("; ".join(_named(each) for each in active) or "none"))
    return DONE


def _described(name: str) -> dict[str, Any]:
    kind = KINDS[name]
    amount = kind.amount
    return {
        "kind": name,
        "text": kind.text,
        "lasts": kind.lasts,
        "servo": kind.servo or None,
        "amount": amount and {"name": amount.name, "low": amount.low, "high": amount.high, "default": amount.default},
    }


def _named(each: dict[str, Any]) -> str:
    words = [each["kind"]]
    if each["servo"]:
        words.append(f"of servo {each['servo']}")
    if each["amount"] is not None:
        words.append(f"({each['amount']:g})")
    if each.get("remaining_s") is not None:
        words.append(f"for {each['remaining_s']:.1f} s more")
    return " ".join(words)


def _ask(options: argparse.Namespace, request: dict[str, Any]) -> dict[str, Any]:
    """Send a request to the charger that the options name.

    Raises:
        CommandError: no charger runs, or it refuses.
    """
    for path in _places(options):
        try:
            reply = ask(path, request)
        except ConnectionError:
            continue
        except OSError as error:
            raise CommandError(f"{path}: {error}; does the charger belong to another user, or does it hang?") from error
        if not reply["success"]:
            raise CommandError(reply["error"])
        return reply
    raise CommandError(_none_runs(options))


def _places(options: argparse.Namespace) -> list[Path]:
    """Return possible paths of the charger's socket: in the folder of its ports, or by ROS domain."""
    if options.directory:
        return [Path(options.directory) / SOCKET]
    return [runtime.charger(domain, options.namespace) for domain in _domains()]


def _domains() -> list[int]:
    """Return the given ROS domain, or else the domain of simulated scenes and domain 0."""
    return [environment.domain()] if os.environ.get("ROS_DOMAIN_ID") else [environment.SIMULATION_DOMAIN, 0]


def _none_runs(options: argparse.Namespace) -> str:
    if options.directory:
        return f"no simulated charger runs on the ports in {options.directory}"
    where = " or ".join(str(domain) for domain in _domains())
    space = f" under the namespace '{options.namespace}'" if options.namespace else ""
    return (
        f"no simulated charger runs in ROS domain {where}{space}: start one with `deltacharger up`, or give the folder "
        "of its ports with --directory"
    )
