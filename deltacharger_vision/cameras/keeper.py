# SPDX-License-Identifier: Apache-2.0
"""Keeps a camera running: finds, opens and monitors it, and reopens it. Independent of ROS; used by camera_node."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Protocol

from deltacharger_vision.errors import VisionError

_SHORTEST_BACKOFF, _LONGEST_BACKOFF = 0.5, 4.0  # s
_LOOK = 0.1  # s between checks of an open camera


class CameraUnavailable(VisionError, RuntimeError):
    """No camera, or one without images; the message names it and states what to do."""


class OpenCamera(Protocol):
    """A camera that delivers images until `problem` reports otherwise.

    Attributes:
        name: identifies the device to people.
    """

    name: str

    def problem(self) -> str:
        """Return why images stopped; '' while they arrive."""

    def close(self) -> None:
        """Release the device."""


class ImageSource(ABC):
    """A thread that delivers images until closed.

    Attributes:
        problem: why there are no images; '' while they arrive.

    Args:
        problem: initial value.
        on_change: called in its thread whenever `problem` changes.
    """

    def __init__(self, problem: str, on_change: Callable[[], None]) -> None:
        self.problem = problem
        self._on_change = on_change
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=type(self).__name__, daemon=True)

    def start(self) -> None:
        """Start delivering images."""
        self._thread.start()

    def close(self) -> None:
        """Stop the thread and release its resources. Idempotent."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join()

    @abstractmethod
    def _run(self) -> None:
        """Deliver images until `_stop` is set."""

    def _set_problem(self, problem: str) -> None:
        if problem != self.problem:
            self.problem = problem
            self._on_change()


class CameraKeeper(ImageSource):
    """One camera, reconnected whenever it returns.

    Attributes:
        name: of the open camera, or the last one; '' before.

    Args:
        open_camera: finds and opens it; raises CameraUnavailable on failure.
        on_change: called in the keeper's thread whenever `problem` changes.
    """

    def __init__(self, open_camera: Callable[[], OpenCamera], on_change: Callable[[], None]) -> None:
        super().__init__("searching for the camera", on_change)
        self.name = ""
        self._open = open_camera

    def _run(self) -> None:
        backoff = _SHORTEST_BACKOFF
        while not self._stop.is_set():
            try:
                camera = self._open()
            except CameraUnavailable as error:
                self._set_problem(str(error))
            else:
                backoff = _SHORTEST_BACKOFF
                self._watch(camera)
            self._stop.wait(backoff)
            backoff = min(2.0 * backoff, _LONGEST_BACKOFF)

    def _watch(self, camera: OpenCamera) -> None:
        """Return when the camera stops delivering; the device is then released."""
        self.name = camera.name
        try:
            self._set_problem("")
            while not (problem := camera.problem()):
                if self._stop.wait(_LOOK):
                    return
            self._set_problem(problem)
        finally:
            camera.close()
