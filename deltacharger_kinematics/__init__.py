"""Kinematics and statics of the inverted delta."""

from deltacharger_kinematics.geometry import DeltaGeometry

__all__ = ["DeltaGeometry"]
