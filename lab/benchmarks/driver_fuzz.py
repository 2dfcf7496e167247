# SPDX-License-Identifier: Apache-2.0
"""Robustness of the driver's codecs against noise: `python lab/benchmarks/driver_fuzz.py [--packets 1000000] [--json]`.

Exit code 1 if a law is violated: no input raises, accepted packets pass the range checks, no false packet passes
CRC-32, no burst of up to 16 bits in packet order reaches a servo's snapshot, and of other damage at most 40 in a
million. Takes some minutes on one core with the default.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from typing import Any

from fuzz_board import fuzz_board
from fuzz_servo import exhaust_bursts, fuzz_instructions, fuzz_servo
from fuzz_wire import SERVO_DAMAGE

ALLOWED_PER_MILLION = 40.0


def violations(result: dict[str, Any]) -> list[str]:
    servo, board, bursts = result["servo_reply"], result["board_link"], result["every_burst"]
    broken = []
    if servo["false_accepts"]["burst_packet_order"] or bursts["packet_order"]["in_the_snapshot"]:
        broken.append("a burst of up to 16 bits in packet order reached the snapshot")
    for kind, rate in servo["false_accepts_per_million"].items():
        if rate > ALLOWED_PER_MILLION:
            broken.append(f"{kind}: {rate:.1f} false replies per million, allowed {ALLOWED_PER_MILLION:.0f}")
    if board["false_accepts"]:
        broken.append(f"{board['false_accepts']} false packets passed CRC-32")
    if servo["out_of_range"] or board["out_of_range"]:
        broken.append("an accepted packet carries a value out of range")
    return broken


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--packets", type=int, default=1_000_000, help="per codec (default 1000000)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="one JSON object instead of text")
    arguments = parser.parse_args()
    if arguments.packets < len(SERVO_DAMAGE):
        parser.error(f"--packets must be at least {len(SERVO_DAMAGE)}")
    started = time.monotonic()
    result: dict[str, Any] = {
        "servo_reply": fuzz_servo(arguments.packets, arguments.seed),
        "every_burst": exhaust_bursts(arguments.seed),
        "board_link": fuzz_board(arguments.packets, arguments.seed),
        "servo_instruction": fuzz_instructions(arguments.packets, arguments.seed),
    }
    result["seconds"] = round(time.monotonic() - started, 1)
    result["broken"] = violations(result)
    if arguments.json:
        print(json.dumps(result))
    else:
        for name, figures in result.items():
            print(f"{name}: {json.dumps(figures, indent=2) if isinstance(figures, dict) else figures}")
    return 1 if result["broken"] else 0


if __name__ == "__main__":
    sys.exit(main())
