# SPDX-License-Identifier: Apache-2.0
"""Checks of the camera: an OAK-D on USB, its library, or image topics of any camera driver."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from deltacharger_bringup.doctor.findings import Finding, hint, ok

_MYRIAD = "03e7"
"""USB vendor of the camera's processor, before and after boot."""
_INSTEAD = "give the coordinates with `deltacharger dock --x-mm --y-mm --z-mm`, or the key 'goal' of the scene"


def examine_camera(publishers: int | None, devices: Path = Path("/sys/bus/usb/devices")) -> Iterator[Finding]:
    """Yield the findings for a camera. None is wrong, because coordinates can replace it.

    Args:
        publishers: of color/image_raw in the charger's ROS domain; None if unknown.
        devices: the kernel's folder of USB devices.
    """
    if find_spec("cv2") is None:
        remedy = "pip install 'deltacharger[vision]', or python3-opencv; without it " + _INSTEAD
        yield hint("camera", "OpenCV, which electrode_detector_node needs, is not installed", remedy)
    if find_spec("depthai") is None:
        remedy = "pip install 'deltacharger[oak]' for camera_node with an OAK-D; other cameras do not need it"
        yield hint("camera", "depthai, the library of OAK-D cameras, is not installed", remedy)
    if _on_usb(devices):
        yield ok("camera", "an OAK camera is on USB")
    else:
        yield hint("camera", "no OAK camera is on USB", "plug it in, if possible directly into USB 3")
    if publishers:
        yield ok("camera", f"{publishers} publisher{'s' if publishers > 1 else ''} of color/image_raw")
    elif publishers is not None:
        remedy = "start camera_node, or the camera's own driver; or " + _INSTEAD
        yield hint("camera", "no publisher of color/image_raw", remedy)


def _on_usb(devices: Path) -> bool:
    for vendor in devices.glob("*/idVendor"):
        try:
            if vendor.read_text().strip() == _MYRIAD:
                return True
        except OSError:
            continue
    return False
