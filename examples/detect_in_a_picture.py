# SPDX-License-Identifier: Apache-2.0
"""From an RGB-D picture to the pose of the electrodes, in the frames of the camera and of the arm.

A simulated camera on its nominal mount takes a picture of electrodes at (12, -9, 84) mm of charger_base, rolled by 4°.
The program prints the detected pose in both frames with standard deviations, confidence and error, and writes the
picture with the result drawn into it. The picture is simulated. Needs deltacharger[vision] (OpenCV).

    python examples/detect_in_a_picture.py [picture.png]
"""

import math
import sys

import cv2
import numpy as np

from deltacharger_vision.detector.detector import ElectrodeDetector, annotated
from deltacharger_vision.mount import Mount
from deltacharger_vision.rendering import camera, scene

out = sys.argv[1] if len(sys.argv) > 1 else "detection.png"
mount = Mount.default()  # charger_base_T_camera
roll = math.radians(4.0)
base_T_terminal = np.eye(4)  # noqa: N816
base_T_terminal[:2, :2] = [[math.cos(roll), -math.sin(roll)], [math.sin(roll), math.cos(roll)]]
base_T_terminal[:3, 3] = 0.012, -0.009, 0.084
picture = camera.SimulatedCamera().render(
    scene.RenderedScene(), np.linalg.inv(mount.pose) @ base_T_terminal, np.random.default_rng(1)
)

found = ElectrodeDetector().detect(picture)  # None if no electrodes are found
cv2.imwrite(out, annotated(picture, found)[:, :, ::-1])
if found is None:
    sys.exit(f"no electrodes in {out}")
placed = mount.place(found)
error = placed.position - base_T_terminal[:3, 3]
stddev = np.sqrt(np.diag(placed.covariance))
print(f"in the camera: {(1000 * found.position).round(1)} mm, confidence {found.confidence:.2f}")
print(f"in charger_base: {(1000 * placed.position).round(1)} ± {(1000 * stddev[:3]).round(1)} mm")
print(f"roll {math.degrees(placed.roll):.1f} ± {math.degrees(stddev[5]):.1f}°")
print(f"off by {1000 * np.linalg.norm(error):.2f} mm; picture with the electrodes drawn in: {out}")
