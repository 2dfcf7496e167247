# SPDX-License-Identifier: Apache-2.0
"""What sees the electrodes: an OAK-D on USB, its library, or image topics of any camera driver."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from deltacharger_bringup.doctor.findings import Finding, hint, ok

_MYRIAD = "03e7"
"""USB vendor of the camera's processor, before and after it has booted."""
_INSTEAD = "give the coordinates with `deltacharger dock --x-mm --y-mm --z-mm`, or the key 'goal' of the scene"


def examine_camera(publishers: int | None, devices: Path = Path("/sys/bus/usb/devices")) -> Iterator[Finding]:
    """Say what there is of a camera. None of it is wrong: coordinates can stand in for it.

    Args:
        publishers: of color/image_raw in the charger's ROS domain; None where that could not be asked.
        devices: folder of the USB devices, as the kernel shows them.
    """
    if find_spec("cv2") is None:
        remedy = "pip install 'deltacharger[vision]', or python3-opencv; without it " + _INSTEAD
        yield hint("camera", "OpenCV, with which electrode_detector_node sees, is not installed", remedy)
    if find_spec("depthai") is None:
        remedy = "pip install 'deltacharger[oak]' where camera_node shall drive an OAK-D; other cameras need none"
        yield hint("camera", "depthai, the library of OAK-D cameras, is not installed", remedy)
    if _on_usb(devices):
        yield ok("camera", "an OAK camera is on USB")
    else:
        yield hint("camera", "no OAK camera is on USB", "plug it in, straight into USB 3 where it has a choice")
    if publishers:
        yield ok("camera", f"{publishers} publisher{'s' if publishers > 1 else ''} of color/image_raw")
    elif publishers is not None:
        remedy = "start camera_node, or the camera's own driver; or " + _INSTEAD
        yield hint("camera", "nobody publishes color/image_raw", remedy)


def _on_usb(devices: Path) -> bool:
    for vendor in devices.glob("*/idVendor"):
        try:
            if vendor.read_text().strip() == _MYRIAD:
                return True
        except OSError:
            continue
    return False
