# SPDX-License-Identifier: Apache-2.0
"""Everything the tactile package can fail with; one root, each kind carries its values and says what to do."""

from __future__ import annotations

from collections.abc import Sequence

from deltacharger_core.picklable import Picklable
from deltacharger_core.texts import cut


class TactileError(Picklable):
    """Root of every error raised by deltacharger_tactile."""


class FrameError(TactileError, ValueError):
    """Taxel arrays do not have the shape of two pads. Example: a flat vector of 100 instead of 10 × 10.

    Args:
        left: shape found for the pad at +x.
        right: shape found for the pad at −x.
    """

    def __init__(self, left: tuple[int, ...], right: tuple[int, ...]) -> None:
        self.left = left
        self.right = right
        super().__init__(f"taxel arrays have shapes {left} and {right}; both must be (..., 10, 10)")


class ModelError(TactileError, ValueError):
    """A file is not a usable estimator. Example: a data set was given where a model belongs.

    Args:
        path: the file.
        reason: what is wrong with it.
    """

    def __init__(self, path: str, reason: str) -> None:
        self.path = path
        self.reason = reason
        super().__init__(f"{path}: not a usable tactile model: {reason}; train one or use the packaged model")


class UnknownModelError(TactileError, LookupError):
    """There is no packaged model of this name. Example: a path instead of a name.

    Args:
        name: what was asked for.
        known: the names that there are.
    """

    def __init__(self, name: str, known: Sequence[str]) -> None:
        self.name = name
        super().__init__(f"there is no packaged model {cut(name, 40)!r}; known are {', '.join(known)}")


class _SourcedError(TactileError, ValueError):
    def __init__(self, source: str, reason: str) -> None:
        self.source = source
        self.reason = reason
        super().__init__(f"{source}: {reason}")


class DatasetError(_SourcedError):
    """A data set is not usable as asked. Example: an array is missing in the npz file.

    Args:
        source: file or protocol.
        reason: what is wrong with it.
    """


class SensorCalibrationError(_SourcedError):
    """A calibration, or the data that it is to be made from, cannot be used. Example: a gain of 0.

    Args:
        source: file or key.
        reason: what is wrong and what to do.
    """
