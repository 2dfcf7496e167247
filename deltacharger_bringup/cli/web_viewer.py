# SPDX-License-Identifier: Apache-2.0
"""Rerun's web viewer in a separate process: the page at one port, the data at the next."""

from __future__ import annotations

import contextlib
import ipaddress
import os
import signal
import socket
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from urllib.parse import quote

from deltacharger_bringup.cli.output import FAILED, CommandError

_START = 10.0  # s to open both ports
_STOP = 5.0  # s to end after SIGTERM
_POLL = 0.05  # s


@dataclass(frozen=True)
class WebAddress:
    """Address of the viewer: an IP address of this computer and the port of the page; the data use the next."""

    host: str = "127.0.0.1"
    port: int = 9090

    @property
    def reachable(self) -> str:
        """Host name for a browser: the name of this computer if the viewer uses all its addresses."""
        if ipaddress.ip_address(self.host).is_unspecified:
            return socket.gethostname()
        return _local(self.host)

    @property
    def data(self) -> str:
        """URL from which a browser loads the data."""
        return f"rerun+http://{self.reachable}:{self.port + 1}/proxy"

    @property
    def sink(self) -> str:
        """URL to which this computer sends the data."""
        return f"rerun+http://{_local(self.host)}:{self.port + 1}/proxy"

    @property
    def page(self) -> str:
        """URL for a browser."""
        return f"http://{self.reachable}:{self.port}/?url={quote(self.data, safe='')}"


class WebViewer:
    """Serve the viewer until the end of a `with` block.

    Args:
        program: the executable `rerun`.
        address: of the viewer.

    Raises:
        CommandError: the viewer cannot be served there.
    """

    def __init__(self, program: Path, address: WebAddress) -> None:
        self.address = address
        self._log = tempfile.TemporaryFile()  # noqa: SIM115  closed by `close`
        options = {
            "--bind": address.host,
            "--port": address.port + 1,
            "--web-viewer-port": address.port,
            "--cors-allow-origin": f"http://{address.reachable}:{address.port}",
        }
        words = [str(word) for option in options.items() for word in option]
        for port in (address.port, address.port + 1):
            self._require_free(port)
        self._process = subprocess.Popen(
            [program, "--serve-web", *words], stdout=self._log, stderr=self._log, start_new_session=True
        )

    def __enter__(self) -> WebViewer:
        end = time.monotonic() + _START
        try:
            while not all(self._serves(port) for port in (self.address.port, self.address.port + 1)):
                if self._process.poll() is not None or time.monotonic() > end:
                    raise CommandError(f"Rerun's web viewer does not start: {self._last_line()}", FAILED)
                time.sleep(_POLL)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the process. Safe to call twice."""
        for number in (signal.SIGTERM, signal.SIGKILL):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_STOP)
                break
        self._log.close()

    def _require_free(self, port: int) -> None:
        family = socket.AF_INET6 if ":" in self.address.host else socket.AF_INET
        with socket.socket(family) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((self.address.host, port))
            except OSError as error:
                raise CommandError(
                    f"port {port} of {self.address.host} cannot be used ({error.strerror}): give another port, "
                    f"--web {self.address.host}:PORT; the data use the next port",
                    FAILED,
                ) from error

    def _serves(self, port: int) -> bool:
        host = _local(self.address.host).strip("[]")
        with contextlib.suppress(OSError), socket.create_connection((host, port), timeout=1.0):
            return True
        return False

    def _last_line(self) -> str:
        self._log.seek(0)
        lines = self._log.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else "no output"


def _local(host: str) -> str:
    """Return the local address of a server at `host`, in the form for a URL."""
    address = ipaddress.ip_address(host)
    if address.is_unspecified:
        return "127.0.0.1" if address.version == 4 else "[::1]"
    return f"[{host}]" if address.version == 6 else host
