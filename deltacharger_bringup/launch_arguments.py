# SPDX-License-Identifier: Apache-2.0
"""Arguments of the launch files: their names, defaults and values, and which of them are refused.

An included launch file inherits every argument of the including one that has the same name. So all but `scene` have a
prefix: a robot's own `namespace` or `camera` does not change its charger.
"""

import sys
from collections.abc import Collection, Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType

from deltacharger_bringup.scenes.scene import Overrides
from deltacharger_core.parameters import declared, did_you_mean

_PACKAGE = "deltacharger"
_PREFIX = "charger_"
_OF_LAUNCH = ("launch-prefix", "launch-prefix-filter", "emulate_tty", "sigterm_timeout", "sigkill_timeout")

Options = Mapping[str, tuple[str, str]]
"""Default and description of each argument by its name without prefix."""

LEVELS = ("debug", "info", "warn", "error", "fatal")
CHARGER: Options = MappingProxyType(
    {
        "scene": ("simulated", "name of a scene, or a YAML file"),
        "namespace": ("", "namespace of the charger"),
        "log_level": ("info", ", ".join(LEVELS)),
        **{item.name: ("", item.text) for item in declared(Overrides)},
    }
)
"""Of charger.launch.py."""

MODEL: Options = MappingProxyType(
    {
        "geometry_file": ("", "same as kinematics_node's parameter"),
        "mount_file": ("", "same as electrode_detector_node's parameter"),
        "base_pose": ("0 0 0 0.5 0.5 0.5 0.5", "pose of charger_base in base_link: x y z, x y z w"),
    }
)
"""Arguments of view.launch.py that are arguments of the xacro too."""

VIEW: Options = MappingProxyType(
    {
        "namespace": ("", "namespace of the charger"),
        **MODEL,
        "frame_prefix": ("", "prefix of the charger's frames, same as its nodes' parameter; base_link has none"),
        "joint_prefix": ("", "prefix of joint_states, same as servo_node's parameter"),
        "rviz": ("true", "false: publish only robot model and tf"),
    }
)
"""Of view.launch.py."""


def in_launch(name: str) -> str:
    """Return the name that an argument has in launch."""
    return name if name == "scene" else _PREFIX + name


def given(options: Options, configurations: Mapping[str, str]) -> dict[str, str]:
    """Return the value of each argument by its name without prefix, from launch's configurations."""
    return {name: configurations[in_launch(name)] for name in options}


def is_launched_itself(file: str) -> bool:
    """Return whether `ros2 launch` started this launch file, and not one that includes it.

    The command line must contain its path, or package and name together: another launch file may have the same name.
    """
    own = Path(file)
    by_path = any(Path(word).name == own.name and Path(word).resolve() == own.resolve() for word in sys.argv)
    return by_path or any(pair == (_PACKAGE, own.name) for pair in pairwise(sys.argv))


def refuse_unknown_arguments(file: str, words: Iterable[str], options: Collection[str]) -> None:
    """Refuse unknown arguments if the launch file was started directly; an including file has its own.

    Args:
        file: path of the launch file.
        words: arguments of the command line, as `name:=value`.
        options: names of the arguments, without prefix.

    Raises:
        ValueError: names the argument and the nearest known one.
    """
    if not is_launched_itself(file):
        return
    known = [in_launch(name) for name in options]
    for word in words:
        name, assigned, _ = word.partition(":=")
        if assigned and name not in known and name not in _OF_LAUNCH:
            hint = did_you_mean(in_launch(name) if name in options else name, known)
            raise ValueError(f"unknown argument '{name}'{hint}; known: {', '.join(known)}")
