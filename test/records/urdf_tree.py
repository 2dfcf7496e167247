# SPDX-License-Identifier: Apache-2.0
"""Frames of a URDF, like robot_state_publisher's, in little code."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class UrdfTree:
    """The frames of a URDF with fixed, revolute or prismatic joints."""

    def __init__(self, text: str) -> None:
        self.root = ElementTree.fromstring(text)
        self.joints = {joint.attrib["name"]: joint for joint in self.root.findall("joint")}
        self.links = [link.attrib["name"] for link in self.root.findall("link")]

    def mimics(self) -> dict[str, tuple[str, float, float]]:
        """Return, for each mimic joint: the mimicked joint, factor and offset."""
        found = {}
        for name, joint in self.joints.items():
            mimic = joint.find("mimic")
            if mimic is not None:
                numbers = float(mimic.get("multiplier", 1.0)), float(mimic.get("offset", 0.0))
                found[name] = (mimic.attrib["joint"], *numbers)
        return found

    def frames(self, values: Mapping[str, float]) -> dict[str, Array]:
        """Return (4, 4) of every link in base_link; every joint that is neither fixed nor a mimic needs a value."""
        joint_values = dict(values)
        for name, (other, factor, offset) in self.mimics().items():
            joint_values[name] = factor * joint_values[other] + offset
        found, waiting = {"base_link": np.eye(4)}, dict(self.joints)
        while waiting:
            ready = {name: each for name, each in waiting.items() if _link(each, "parent") in found}
            assert ready, f"not connected to base_link: {sorted(waiting)}"
            for name, joint in ready.items():
                del waiting[name]
                moved = _moved(joint, joint_values[name]) if joint.attrib["type"] != "fixed" else np.eye(4)
                found[_link(joint, "child")] = found[_link(joint, "parent")] @ _origin(joint) @ moved
        assert set(found) == set(self.links)
        return found


def _link(joint: ElementTree.Element, which: str) -> str:
    found = joint.find(which)
    assert found is not None
    return found.attrib["link"]


def _numbers(element: ElementTree.Element | None, key: str) -> Array:
    text = "0 0 0" if element is None else element.get(key, "0 0 0")
    return np.array([float(word) for word in text.split()])


def _origin(joint: ElementTree.Element) -> Array:
    origin = joint.find("origin")
    found = np.eye(4)
    roll, pitch, yaw = _numbers(origin, "rpy")
    found[:3, :3] = _turn((0, 0, 1), yaw) @ _turn((0, 1, 0), pitch) @ _turn((1, 0, 0), roll)
    found[:3, 3] = _numbers(origin, "xyz")
    return found


def _moved(joint: ElementTree.Element, value: float) -> Array:
    axis = _numbers(joint.find("axis"), "xyz")
    found = np.eye(4)
    if joint.attrib["type"] == "prismatic":
        found[:3, 3] = value * axis
    else:
        assert joint.attrib["type"] == "revolute"
        found[:3, :3] = _turn(axis, value)
    return found


def _turn(axis: Array | tuple[int, int, int], angle: float) -> Array:
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * skew + (1.0 - math.cos(angle)) * skew @ skew)
