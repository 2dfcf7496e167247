# SPDX-License-Identifier: Apache-2.0
"""Names of the charger's coordinate frames, and the parameters of the nodes that use them."""

from __future__ import annotations

from dataclasses import dataclass

from deltacharger_core.parameters import Bounded, ParameterError, number, words

CHARGER_BASE = "charger_base"
END_EFFECTOR = "end_effector"
CAMERA = "camera_color_optical_frame"
LONGEST = 256  # characters of a frame's name
_PREFIX_MAX = 64  # characters


@dataclass(frozen=True)
class FrameParameters(Bounded):
    """Prefix that distinguishes the frames of two chargers.

    Raises:
        ParameterError: the prefix begins with "/" (not allowed by tf), has white space or is too long.
    """

    frame_prefix: str = words(
        "", "prefix of every frame name of the charger, same as robot_state_publisher's frame_prefix, e.g. left/"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        _check("frame_prefix", self.frame_prefix)

    def named(self, frame: str) -> str:
        """Return the full name of a frame of the charger."""
        return f"{self.frame_prefix}{frame}"


@dataclass(frozen=True)
class JointFrameParameters(FrameParameters):
    """Prefixes of frames and joints of two chargers in one URDF. robot_state_publisher does not prefix joints.

    Raises:
        ParameterError: as in `FrameParameters`, for either prefix.
    """

    joint_prefix: str = words("", "prefix of the names in joint_states: the prefix of the URDF's macro, e.g. left_")

    def __post_init__(self) -> None:
        super().__post_init__()
        _check("joint_prefix", self.joint_prefix)


@dataclass(frozen=True)
class TransformParameters(FrameParameters):
    """Timeout and maximum age of tf transforms. They take effect only if tf2_ros is installed."""

    transform_timeout: float = number(2.0, 0.0, 10.0, "s", "longest wait for a transform that tf does not provide")
    transform_age_max: float = number(
        1.0, 0.05, 60.0, "s", "maximum age of a moving transform and of a stamped pose that needs one"
    )


def _check(name: str, prefix: str) -> None:
    """Refuse an invalid prefix; `name` is its parameter."""
    if prefix.startswith("/") or len(prefix.split()) > 1 or prefix != prefix.strip() or len(prefix) > _PREFIX_MAX:
        problem = f"{prefix[:_PREFIX_MAX]!a}: give at most {_PREFIX_MAX} characters, no white space, no leading '/'"
        raise ParameterError(name, prefix, problem)
