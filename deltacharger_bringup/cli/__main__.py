# SPDX-License-Identifier: Apache-2.0
"""The entry point of the command: handles signals before anything else is imported.

Also runs it from the sources: python -m deltacharger_bringup.cli.
"""

import os
import signal
import sys

from deltacharger_core import signals

_SERVERS = ("up", "simulate")  # end with 0 on SIGTERM and SIGHUP


def main() -> int:
    """Run the command and return its exit code."""
    serves = sys.argv[1:2] and sys.argv[1] in _SERVERS
    signals.end_at_once(_told, signals.ENDING if serves else (signal.SIGINT,))
    from deltacharger_bringup.cli.main import main as run

    return run()


def _told(number: int) -> int:
    """Return the exit code of a command that a signal ends before it began, and say so as it would later."""
    if number != signal.SIGINT or "--as-node" in sys.argv:
        return 0
    try:
        os.write(2, b"interrupted\n")
        if "--json" in sys.argv:
            os.write(1, b'{"success": false, "error": "interrupted"}\n')
    except OSError:  # a closed stream
        pass
    return 130


if __name__ == "__main__":
    sys.exit(main())
