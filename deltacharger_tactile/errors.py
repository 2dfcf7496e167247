# SPDX-License-Identifier: Apache-2.0
"""Errors of the tactile package: one root; each kind carries its values and states what to do."""


class TactileError(Exception):
    """Root of every error raised by deltacharger_tactile."""


class FrameError(TactileError, ValueError):
    """Taxel arrays do not have the shape of two pads. Example: a vector of 100 instead of 10 × 10.

    Args:
        left: shape of the pad at +x.
        right: shape of the pad at −x.
    """

    def __init__(self, left: tuple[int, ...], right: tuple[int, ...]) -> None:
        self.left = left
        self.right = right
        super().__init__(f"taxel arrays have shapes {left} and {right}; both must be (..., 10, 10)")


class ModelError(TactileError, ValueError):
    """A file is not a usable estimator. Example: a data set instead of a model.

    Args:
        path: the file.
        reason: what is wrong.
    """

    def __init__(self, path: str, reason: str) -> None:
        self.path = path
        self.reason = reason
        super().__init__(f"{path}: not a usable tactile model: {reason}; train one or use the packaged model")


class _SourcedError(TactileError, ValueError):
    def __init__(self, source: str, reason: str) -> None:
        self.source = source
        self.reason = reason
        super().__init__(f"{source}: {reason}")


class DatasetError(_SourcedError):
    """A data set is unusable. Example: an array is missing in the npz file.

    Args:
        source: file or protocol.
        reason: what is wrong and what to do.
    """


class SensorCalibrationError(_SourcedError):
    """A calibration, or the data to make one from, is unusable. Example: a gain of 0.

    Args:
        source: file or key.
        reason: what is wrong and what to do.
    """
