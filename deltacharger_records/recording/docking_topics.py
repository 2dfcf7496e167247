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
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from trajectory_msgs.msg import JointTrajectory

from deltacharger_ros.raw_topics import Topic

_DEPTH = 500  # no loss if the disk hangs for seconds
_EVERY = QoSProfile(depth=_DEPTH)
_LATCHED = QoSProfile(depth=_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_SENSOR = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)

STATE = "docking_state"
DECISION = "docking_decision"
ACTIONS = ("dock", "undock")

TOPICS: tuple[Topic, ...] = (
    Topic(STATE, DockingState, _LATCHED),
    Topic(DECISION, DockingDecision, _EVERY),
    Topic("servo_state", ServoState, _EVERY),
    Topic("tactile_frame", TactileFrame, _SENSOR),
    Topic("charger_power", ChargerPower, _EVERY),
    Topic("misalignment", Misalignment, _EVERY),
    Topic("electrode_detection", ElectrodeDetection, _EVERY),
    Topic("joint_trajectory", JointTrajectory, _EVERY),
    Topic("contact_wrench", WrenchStamped, _EVERY),
    Topic("end_effector_pose", PoseStamped, _EVERY),
    Topic("dock/_action/feedback", Dock.Impl.FeedbackMessage, _EVERY),
    Topic("dock/_action/status", GoalStatusArray, _LATCHED),
    Topic("undock/_action/feedback", Undock.Impl.FeedbackMessage, _EVERY),
    Topic("undock/_action/status", GoalStatusArray, _LATCHED),
)
"""In a record, each has its full name."""

ALWAYS = (STATE, DECISION, "electrode_detection", "dock/_action/status", "undock/_action/status")
"""Topics of which every message is kept, even over hours of charging."""
