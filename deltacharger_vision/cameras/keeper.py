# SPDX-License-Identifier: Apache-2.0
"""Keeps a camera delivering: looks for it, opens it, watches it, and opens it again. No ROS; camera_node wraps it."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Protocol

from deltacharger_vision.errors import VisionError

_SHORTEST_BACKOFF, _LONGEST_BACKOFF = 0.5, 4.0  # s
_LOOK = 0.1  # s between two looks at a camera that is open


class CameraUnavailable(VisionError, RuntimeError):
    """There is no camera, or it does not deliver; the message names it and says what to do."""


class OpenCamera(Protocol):
    """A camera that delivers until `problem` says otherwise.

    Attributes:
        name: of the device, as people tell it apart from others.
    """

    name: str

    def problem(self) -> str:
        """Return why it delivers no more, '' while it does."""

    def close(self) -> None:
        """Release the device."""


class ImageSource(ABC):
    """A thread that delivers images until it is closed.

    Attributes:
        problem: why there is no image, '' while they come.

    Args:
        problem: at the beginning.
        on_change: called in its thread whenever `problem` changes.
    """

    def __init__(self, problem: str, on_change: Callable[[], None]) -> None:
        self.problem = problem
        self._on_change = on_change
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=type(self).__name__, daemon=True)

    def start(self) -> None:
        """Begin to look for images."""
        self._thread.start()

    def close(self) -> None:
        """End the thread, and release what it holds. Idempotent."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join()

    @abstractmethod
    def _run(self) -> None:
        """Deliver images until `_stop` is set."""

    def _tell(self, problem: str) -> None:
        if problem != self.problem:
            self.problem = problem
            self._on_change()


class CameraKeeper(ImageSource):
    """One camera, from plugging in to unplugging, as often as it takes.

    Attributes:
        name: of the camera that is open, or was last; '' before.

    Args:
        open_camera: finds and opens it; raises CameraUnavailable where it cannot.
        on_change: called in the keeper's thread whenever `problem` changes.
    """

    def __init__(self, open_camera: Callable[[], OpenCamera], on_change: Callable[[], None]) -> None:
        super().__init__("the camera is looked for", on_change)
        self.name = ""
        self._open = open_camera

    def _run(self) -> None:
        backoff = _SHORTEST_BACKOFF
        while not self._stop.is_set():
            try:
                camera = self._open()
            except CameraUnavailable as error:
                self._tell(str(error))
            else:
                backoff = _SHORTEST_BACKOFF
                self._watch(camera)
            self._stop.wait(backoff)
            backoff = min(2.0 * backoff, _LONGEST_BACKOFF)

    def _watch(self, camera: OpenCamera) -> None:
        """Return when the camera delivers no more, with the device released."""
        self.name = camera.name
        try:
            self._tell("")
            while not (problem := camera.problem()):
                if self._stop.wait(_LOOK):
                    return
            self._tell(problem)
        finally:
            camera.close()
