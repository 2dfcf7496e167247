# SPDX-License-Identifier: Apache-2.0
"""`deltacharger view`: show a live or recorded charger in Rerun, on a screen, in a browser or in a file.

Rerun's web viewer runs in a separate process: the page at one port, the data at the next.
"""

from __future__ import annotations

import argparse
import contextlib
import ipaddress
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from deltacharger_bringup.cli import arguments, charger, output
from deltacharger_bringup.cli.scene import load_for_command
from deltacharger_bringup.scenes.scene import Scene
from deltacharger_core import environment
from deltacharger_core.files import given_path
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_vision.mount import Mount

if TYPE_CHECKING:
    from deltacharger_bringup.records.view.feed import ViewFeed

Settings = tuple[DockingParameters, DeltaGeometry]
_SILENT_AFTER = 5.0  # s; after a missed announcement of a topic the next comes 3 s later
_PERIOD = 1.0 / 30.0  # s between two readings of the topics
_FLUSH = 10.0  # s for pending data to reach the viewer
_START, _STOP = 10.0, 5.0  # s for the web viewer to open its ports, and to end after SIGTERM
_EXTRA = "install deltacharger[view], or `pip install 'rerun-sdk>=0.39'`"


@dataclass(frozen=True)
class WebAddress:
    """Address of the web viewer: an IPv4 address of this computer and the port of the page; the data use the next."""

    host: str = "127.0.0.1"
    port: int = 9090

    @property
    def local(self) -> str:
        """The address for this computer."""
        return "127.0.0.1" if self.host == "0.0.0.0" else self.host

    @property
    def reachable(self) -> str:
        """Host name for a browser: the name of this computer if the viewer uses all its addresses."""
        return socket.gethostname() if self.host == "0.0.0.0" else self.host

    @property
    def sink(self) -> str:
        """URL to which this computer sends the data."""
        return f"rerun+http://{self.local}:{self.port + 1}/proxy"

    @property
    def page(self) -> str:
        """URL for a browser."""
        data = f"rerun+http://{self.reachable}:{self.port + 1}/proxy"
        return f"http://{self.reachable}:{self.port}/?url={quote(data, safe='')}"


def web_address(text: str) -> WebAddress:
    """Return an address of this computer, ADDRESS or ADDRESS:PORT."""
    host, _, port = text.partition(":")
    try:
        address = WebAddress(str(ipaddress.IPv4Address(host)), int(port or WebAddress.port))
    except ValueError:
        address = WebAddress(port=0)
    if not 0 < address.port < 65535:
        raise argparse.ArgumentTypeError(f"'{text}': give an IPv4 address with or without a port, such as 0.0.0.0:9090")
    return address


def add_view(parser: argparse.ArgumentParser) -> None:
    """Add the options of `view`."""
    parser.add_argument("--recording", metavar="FILE.mcap", help="show this recording instead of a running charger")
    parser.add_argument(
        "--scene", metavar="NAME|FILE", help="scene with geometry and camera mount to draw (default: nominal ones)"
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--save", metavar="FILE.rrd", help="write a file instead of opening a window")
    where.add_argument(
        "--web",
        metavar="ADDRESS[:PORT]",
        type=web_address,
        nargs="?",
        const=WebAddress(),
        help="serve it to a browser (default: 127.0.0.1:9090); the data use the next port",
    )
    parser.add_argument("--camera", action="store_true", help="also subscribe to and show the image, at 5 Hz")
    parser.add_argument(
        "--stop-after-s",
        type=arguments.NOT_NEGATIVE,
        default=0.0,
        metavar="S",
        help="show it for this time (until Ctrl-C)",
    )
    arguments.namespace_option(parser)


def view(options: argparse.Namespace) -> output.Result:
    """Show a running charger until an interruption, or a recording."""
    rr = _rerun()
    _check_places(options)
    show = _show_charger if options.recording is None else _show_recording
    if options.web is None:
        return show(rr, options)
    with _serving(options.web):
        output.log_line(f"open {options.web.page}")
        return show(rr, options)


def _rerun() -> Any:
    try:
        import rerun
    except ImportError as error:
        raise output.CommandError(f"{error.name} is not installed: {_EXTRA}", output.WRONG_INPUT) from error
    if not hasattr(rerun, "StateChange"):  # another package of this name, or too old
        raise output.CommandError(
            f"the installed package rerun is too old or another one: {_EXTRA}", output.WRONG_INPUT
        )
    return rerun


def _check_places(options: argparse.Namespace) -> None:
    """Check files and viewer before the start, so that nothing fails at the end."""
    if options.recording is not None:
        arguments.file_to_read("--recording", options.recording)
    if options.recording is not None and options.stop_after_s:
        raise output.CommandError("--stop-after-s is for a running charger, not for --recording", output.WRONG_INPUT)
    if options.save is not None:
        arguments.file_to_write("--save", options.save, ".rrd")
    has_screen = sys.platform != "linux" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if not (options.save or options.web or has_screen):
        raise output.CommandError(
            "no screen found: give --web and open its page in a browser, or --save FILE.rrd and open it elsewhere with "
            "`rerun FILE.rrd`",
            output.WRONG_INPUT,
        )


def _open(
    rr: Any, options: argparse.Namespace, scene: Scene, settings: Settings | None = None
) -> tuple[ViewFeed, Callable[[], None]]:
    """Return the feed to the output that the options name, and the function that completes it.

    Args:
        rr: the module rerun.
        options: of the command.
        scene: its camera is drawn, and its arm if there are no `settings`.
        settings: the charger's docking parameters and its arm.
    """
    from deltacharger_bringup.records.view.feed import ViewFeed
    from deltacharger_bringup.records.view.log import ViewLog, blueprint

    (parameters, geometry), camera = settings or settings_of(scene), mount_of(scene)
    recording = rr.RecordingStream("deltacharger")
    layout = blueprint(live=options.recording is None and options.save is None)
    try:
        if options.save is not None:
            recording.save(options.save, default_blueprint=layout)
        elif options.web is not None:
            recording.connect_grpc(options.web.sink, default_blueprint=layout)
        else:
            _find_viewer()
            recording.spawn(default_blueprint=layout)
    except (OSError, RuntimeError, ValueError) as error:
        raise output.CommandError(f"Rerun cannot start: {error}", output.FAILED) from error
    return ViewFeed(ViewLog(rr, recording, geometry, camera), geometry, parameters), partial(_close, recording)


@contextlib.contextmanager
def _serving(address: WebAddress) -> Iterator[None]:
    """Serve the web viewer during a `with` block.

    Raises:
        CommandError: it is not installed, or cannot be served there.
    """
    package = find_spec("rerun_cli")
    if package is None or package.origin is None:
        raise output.CommandError(f"Rerun's viewer is not installed: {_EXTRA}", output.WRONG_INPUT)
    ports = (address.port, address.port + 1)
    for port in ports:
        _require_free(address, port)
    words = ["--bind", address.host, "--port", str(ports[1]), "--web-viewer-port", str(ports[0])]
    words += ["--cors-allow-origin", f"http://{address.reachable}:{address.port}"]
    program = Path(package.origin).with_name("rerun")
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen([program, "--serve-web", *words], stdout=log, stderr=log, start_new_session=True)
        try:
            end = time.monotonic() + _START
            while not all(_serves(address, port) for port in ports):
                if process.poll() is not None or time.monotonic() > end:
                    log.seek(0)
                    lines = log.read().decode(errors="replace").strip().splitlines() or ["no output"]
                    raise output.CommandError(f"Rerun's web viewer does not start: {lines[-1]}", output.FAILED)
                time.sleep(_PERIOD)
            yield
        finally:
            for number in (signal.SIGTERM, signal.SIGKILL):
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, number)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(_STOP)
                    break


def _require_free(address: WebAddress, port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((address.host, port))
        except OSError as error:
            raise output.CommandError(
                f"port {port} of {address.host} cannot be used ({error.strerror}): give another port, "
                f"--web {address.host}:PORT; the data use the next port",
                output.FAILED,
            ) from error


def _serves(address: WebAddress, port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection((address.local, port), timeout=1.0):
        return True
    return False


def _find_viewer() -> None:
    """Let Rerun find the viewer installed with it, also if this environment is not activated."""
    beside = str(Path(sys.executable).parent)
    os.environ["PATH"] = os.pathsep.join([beside, os.environ.get("PATH", os.defpath)])


def _close(recording: Any) -> None:
    """Wait until all logged data have arrived."""
    try:
        recording.flush(timeout_sec=_FLUSH)
    except Exception as error:  # rerun raises its own classes; the data are lost
        raise output.CommandError(f"not everything reached the viewer: {error}", output.FAILED) from error
    finally:
        recording.disconnect()


def settings_of(scene: Scene) -> Settings:
    """Return docking_node's parameters and kinematics_node's geometry, as a scene sets them.

    Raises:
        CommandError: the geometry's file cannot be read, or a value is refused; exit code 2.
    """
    from deltacharger_bringup.records.node_parameters import docking_settings

    given = scene.parameters.get("kinematics_node", {})
    with output.wrong_input(OSError, ValueError, before=f"{scene.file}: parameters: "):
        return docking_settings({**scene.parameters.get("docking_node", {}), **given})


def mount_of(scene: Scene) -> NDArray[np.float64]:
    """Return the pose (4, 4) of the camera in charger_base, as a scene sets it for electrode_detector_node.

    Raises:
        CommandError: it is refused; exit code 2.
    """
    given = scene.parameters.get("electrode_detector_node", {})
    with output.wrong_input(OSError, ValueError, before=f"{scene.file}: parameters.electrode_detector_node: "):
        return (Mount.load(given_path(given["mount_file"])) if given.get("mount_file") else Mount.default()).pose


def _show_charger(rr: Any, options: argparse.Namespace) -> output.Result:
    scene = charger.prepare(options, look_around=True)
    with output.Interrupts() as interrupts, charger.ros_context() as context:
        from deltacharger_bringup.records.view.feed import COLOR_IMAGE, TOPICS, Listener

        feed, complete = _open(rr, options, scene)
        topics = [topic for topic in TOPICS if options.camera or topic.name != COLOR_IMAGE]
        listener = Listener(context, options.namespace, topics)
        began = time.monotonic()
        silent: list[str] | None = None
        try:
            output.log_line(f"listening in ROS domain {environment.domain()}; Ctrl-C ends it")
            while not interrupts.event.wait(_PERIOD):
                listener.hand(feed)
                passed = time.monotonic() - began
                if silent is None and passed > _SILENT_AFTER:
                    silent = _report_silence(feed, options.namespace)
                if options.stop_after_s and passed > options.stop_after_s:
                    break
        finally:
            listener.close()
            complete()
    return _report(options, feed, time.monotonic() - began, interrupts, silent or ())


def _report_silence(feed: ViewFeed, namespace: str) -> list[str]:
    from deltacharger_bringup.records.view.feed import ALWAYS_THERE

    silent = [f"/{namespace}/{name}" if namespace else f"/{name}" for name in ALWAYS_THERE if not feed.counts[name]]
    if silent:
        hint = "is a charger running" if len(silent) == len(ALWAYS_THERE) else "are their nodes running"
        output.log_line(
            f"no messages for {_SILENT_AFTER:g} s on {', '.join(silent)}: {hint} in ROS domain "
            f"{environment.domain()}, in this namespace? Still listening"
        )
    return silent


def _show_recording(rr: Any, options: argparse.Namespace) -> output.Result:
    scene = load_for_command(options.scene or arguments.DEFAULT_SCENE)
    environment.prepare()
    from deltacharger_bringup.records.node_parameters import recorded_settings
    from deltacharger_bringup.records.recording.recorded import Recording
    from deltacharger_bringup.records.view.feed import TOPICS, play
    from deltacharger_core.mcap_file import RecordingError

    began = time.monotonic()
    with output.wrong_input(RecordingError):
        recording = Recording(Path(options.recording), options.namespace, TOPICS, states=False)
        settings = recorded_settings(recording.file)
        with output.Interrupts() as interrupts:
            own = settings if options.scene is None else None
            feed, complete = _open(rr, options, scene, own)
            try:
                play(recording, feed, interrupts.event.is_set)
                if options.web is not None:
                    output.log_line("shown; Ctrl-C ends the viewer")
                    interrupts.event.wait()
            finally:
                complete()
    return _report(options, feed, time.monotonic() - began, interrupts)


def _report(
    options: argparse.Namespace, feed: ViewFeed, took: float, interrupts: output.Interrupts, silent: Sequence[str] = ()
) -> output.Result:
    """Return what was shown."""
    counts = dict(sorted(feed.counts.items()))
    place = options.save or (options.web.page if options.web else "")
    total = f"{sum(counts.values())} messages of {len(counts)} topics"
    remarks = [f"{total} in {took:.1f} s{f'; {place}' if place else ''}"]
    if options.save is not None:
        remarks.append(f"open it with: rerun {options.save}")
    details = {"success": True, "saved": options.save, "messages": counts, "silent": list(silent), "elapsed": took}
    return output.Result("", details, interrupts.exit_code(output.DONE), remarks)
