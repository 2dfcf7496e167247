# SPDX-License-Identifier: Apache-2.0
"""Errors of the vision package: one root; each kind carries its values and states what to do."""


class VisionError(Exception):
    """Root of every error raised by deltacharger_vision."""


class _SourcedError(VisionError, ValueError):
    def __init__(self, source: str, reason: str) -> None:
        self.source = source
        self.reason = reason
        super().__init__(f"{source}: {reason}")


class ImageError(_SourcedError):
    """Arrays are not an RGB-D image. Example: colour 640 × 400 and depth 1280 × 720.

    Args:
        source: color, depth or intrinsics.
        reason: what is wrong and what to give instead.
    """


class CameraInfoError(_SourcedError):
    """Intrinsics or a calibration file are unusable. Example: fx = 0 of an uncalibrated camera.

    Args:
        source: file, or name of the values.
        reason: what is wrong and what to do.
    """


class TerminalError(_SourcedError):
    """A terminal's geometry is unusable. Example: a file in millimetres, bar_length: 70.

    Args:
        source: file or field.
        reason: what is wrong and what to do.
    """


class MountError(_SourcedError):
    """The camera's pose on the charger is unusable. Example: a quaternion of length 0.

    Args:
        source: file or field.
        reason: what is wrong and what to do.
    """


class BoardError(_SourcedError):
    """A board description is unusable. Example: `apriltag:36h11:900`; the family has 587 tags.

    Args:
        source: affected part.
        reason: what is wrong and what to do.
    """
