# SPDX-License-Identifier: Apache-2.0
"""Topics of a docking record, with their messages and quality of service."""

from __future__ import annotations

from action_msgs.msg import GoalStatusArray
from deltacharger.action import Dock, Undock
from deltacharger.msg import (
    ChargerPower,
    DockingDecision,
    DockingState,
    ElectrodeDetection,
    Misalignment,
    ServoState,
    TactileFrame,
)
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.qos import QoSProfile
from trajectory_msgs.msg import JointTrajectory

from deltacharger_ros import qos
from deltacharger_ros.raw_topics import Topic

_DEFAULT = QoSProfile(depth=qos.DEFAULT_DEPTH)

STATE = "docking_state"
DECISION = "docking_decision"
ACTIONS = ("dock", "undock")

TOPICS: tuple[Topic, ...] = (
    Topic(STATE, DockingState, qos.STATE),
    Topic(DECISION, DockingDecision, _DEFAULT),
    Topic("servo_state", ServoState, qos.LATEST),
    Topic("tactile_frame", TactileFrame, qos.SENSOR),
    Topic("charger_power", ChargerPower, qos.LATEST),
    Topic("misalignment", Misalignment, _DEFAULT),
    Topic("electrode_detection", ElectrodeDetection, _DEFAULT),
    Topic("joint_trajectory", JointTrajectory, qos.LATEST),
    Topic("contact_wrench", WrenchStamped, _DEFAULT),
    Topic("end_effector_pose", PoseStamped, _DEFAULT),
    Topic("dock/_action/feedback", Dock.Impl.FeedbackMessage, _DEFAULT),
    Topic("dock/_action/status", GoalStatusArray, qos.STATE),
    Topic("undock/_action/feedback", Undock.Impl.FeedbackMessage, _DEFAULT),
    Topic("undock/_action/status", GoalStatusArray, qos.STATE),
)
"""In a record, each has its full name."""

ALWAYS = (STATE, DECISION, "electrode_detection", "dock/_action/status", "undock/_action/status")
"""Topics of which every message is kept, even over hours of charging."""
