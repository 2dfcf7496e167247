# SPDX-License-Identifier: Apache-2.0
"""The URDF closes the loops of the delta: by forward kinematics, both ends of each rod meet arm and platform."""

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from deltacharger_bringup.records.view.shapes import ROD_SPACING, SIDES, moving
from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_kinematics.geometry import LimbAdjustment, save_geometry
from deltacharger_kinematics.passive_joints import passive_joints
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_vision.mount import Mount, look_at

from ..chargers import Spin, wait_until
from ..nodes import options

pytestmark = pytest.mark.ros

Array = NDArray[np.float64]

URDF = Path(__file__).resolve().parents[2] / "urdf"
XACRO = URDF / "deltacharger.urdf.xacro"
BAKED = URDF / "deltacharger.urdf"
EXACT = 1e-9  # m
CALIBRATED = DeltaGeometry(
    arm=0.1004,
    z_offset=0.0948,
    limbs=(
        LimbAdjustment(radius_offset=0.0007, tangential_offset=-0.0004, rod=0.1803, angle_offset=0.012),
        LimbAdjustment(height_offset=0.0006, arm=0.0997, angle_offset=-0.02),
        LimbAdjustment(tangential_offset=0.0011, rod=0.1795),
    ),
)


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


def poses(geometry: DeltaGeometry) -> Array:
    """Return the corners of the workspace and points inside."""
    low, high = np.array(geometry.workspace_min), np.array(geometry.workspace_max)
    grid = np.stack(np.meshgrid(*np.linspace(low, high, 2).T, indexing="ij"), axis=-1).reshape(-1, 3)
    drawn = np.random.default_rng(3).uniform(low, high, (6, 3))
    return np.concatenate([grid, drawn])


def check_loops(tree: UrdfTree, geometry: DeltaGeometry) -> None:
    delta, scalar = Delta(geometry), ScalarDelta(geometry)
    for point in poses(geometry):
        angles = [float(angle) for angle in delta.inverse(point).angles]
        joints = {f"limb_{index}_arm_joint": angle for index, angle in enumerate(angles)}
        frames = tree.frames(joints | passive_joints(scalar, angles))
        base = np.linalg.inv(frames["charger_base"])
        platform = base @ frames["end_effector"]
        np.testing.assert_allclose(platform[:3, 3], point, atol=EXACT)
        np.testing.assert_allclose(platform[:3, :3], np.eye(3), atol=1e-12)
        arms, rods = moving(geometry, angles, point)
        for index in range(3):
            limb = geometry.limb(index)
            elbow = base @ frames[f"limb_{index}_arm"] @ (limb.arm, 0.0, 0.0, 1.0)
            np.testing.assert_allclose(arms[index, 1], elbow[:3], atol=EXACT)
            for number, (side, share) in enumerate(SIDES):
                rod = base @ frames[f"limb_{index}_rod_{side}"]
                arm = base @ frames[f"limb_{index}_arm"]
                at_arm = arm @ (limb.arm, share * ROD_SPACING, 0.0, 1.0)
                at_platform = platform @ (*foot(geometry, index, share), 1.0)
                np.testing.assert_allclose(rod[:3, 3], at_arm[:3], atol=EXACT)
                np.testing.assert_allclose((rod @ (limb.rod, 0.0, 0.0, 1.0))[:3], at_platform[:3], atol=EXACT)
                np.testing.assert_allclose(rods[2 * index + number], [at_arm[:3], at_platform[:3]], atol=EXACT)


def foot(geometry: DeltaGeometry, index: int, share: float) -> Array:
    """End of a rod on the platform, from the definition of a limb alone."""
    azimuth = 2.0 * math.pi * index / 3.0
    outward = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    along = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    return np.asarray(geometry.platform_radius * outward + share * ROD_SPACING * along)


def expanded(**arguments: object) -> str:
    xacro = pytest.importorskip("xacro", reason="`pip install xacro`, or a ROS installation")
    words = {name: str(value) for name, value in arguments.items()}
    return str(xacro.process_file(str(XACRO), mappings=words).toprettyxml(indent="  "))


@pytest.mark.parametrize("geometry", [DeltaGeometry(), CALIBRATED], ids=["nominal", "calibrated"])
def test_the_rods_meet_arms_and_platform_everywhere(geometry: DeltaGeometry, tmp_path: Path) -> None:
    text = BAKED.read_text(encoding="utf-8")
    if geometry is CALIBRATED:
        save_geometry(geometry, tmp_path / "geometry.yaml")
        text = expanded(geometry_file=tmp_path / "geometry.yaml")
    check_loops(UrdfTree(text), geometry)


def test_the_committed_urdf_equals_the_xacro() -> None:
    def plain(text: str) -> list[tuple[str, dict[str, str]]]:
        return [(each.tag, each.attrib) for each in ElementTree.fromstring(text).iter()]

    assert plain(expanded()) == plain(BAKED.read_text(encoding="utf-8"))


def test_frames_are_where_the_interface_defines_them(tmp_path: Path) -> None:
    joints = {f"limb_{index}_arm_joint": 0.0 for index in range(3)} | passive_joints(ScalarDelta(), (0.0, 0.0, 0.0))
    frames = UrdfTree(BAKED.read_text(encoding="utf-8")).frames(joints)
    base = frames["charger_base"]
    np.testing.assert_allclose(base[:3, :3] @ np.eye(3), [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-12)
    np.testing.assert_allclose(
        np.linalg.inv(base) @ frames["camera_color_optical_frame"], Mount.default().pose, atol=1e-9
    )
    np.testing.assert_allclose((np.linalg.inv(base) @ frames["delta_motor"])[:3, 3], [0.0, 0.0, -0.095], atol=1e-12)
    other = Mount(look_at((0.02, 0.15, -0.1), (0.0, 0.0, 0.1)), Mount.default().covariance)
    other.save(tmp_path / "mount.yaml")
    moved = UrdfTree(expanded(mount_file=tmp_path / "mount.yaml", base_pose="0.2 0.0 0.5 0 0 0 1")).frames(joints)
    np.testing.assert_allclose(moved["charger_base"][:3], np.c_[np.eye(3), [0.2, 0.0, 0.5]], atol=1e-12)
    seen = np.linalg.inv(moved["charger_base"]) @ moved["camera_color_optical_frame"]
    np.testing.assert_allclose(seen, other.pose, atol=1e-6)  # of seven and nine decimals in the file


@pytest.mark.version
def test_the_node_publishes_them_and_nothing_while_a_servo_is_silent(context: Any, namespace: str, spin: Spin) -> None:
    from deltacharger.msg import ServoState
    from rclpy.node import Node
    from sensor_msgs.msg import JointState

    from deltacharger_bringup.records.view.passive_joints_node import PassiveJointsNode
    from deltacharger_core.ros import qos

    came: list[JointState] = []
    spin(PassiveJointsNode(**options(context, namespace)))
    tester = spin(Node("tester", **options(context, namespace)))
    states = tester.create_publisher(ServoState, "servo_state", qos.LATEST)
    tester.create_subscription(JointState, "joint_states", came.append, qos.DEFAULT_DEPTH)
    angles = [0.1, -0.2, 0.3]

    def state(second: int, valid: bool, shift: float = 0.0) -> ServoState:
        message = ServoState(position=[angle + shift for angle in angles], valid=[True, valid, True])
        message.header.stamp.sec = second
        return message

    wait_until(lambda: states.get_subscription_count(), "the node's subscription")
    wait_until(lambda: tester.count_publishers("joint_states"), "its publisher")
    states.publish(state(1, valid=False, shift=0.1))
    second = iter(range(2, 10_000))
    wait_until(lambda: states.publish(state(next(second), valid=True)) or came, "joint states")
    expected = passive_joints(ScalarDelta(), angles)
    assert passive_joints(ScalarDelta(), (math.nan, 0.0, 0.0)) == {}
    assert list(came[0].name) == list(expected)
    assert list(came[0].position) == pytest.approx(list(expected.values()), abs=1e-12)
    assert came[0].header.stamp.sec >= 2
