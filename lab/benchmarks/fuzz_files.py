# SPDX-License-Identifier: Apache-2.0
"""All readers of files from others: good files by our own writers, their changes, and checks of accepted data.

Each reader names the errors that it may raise, and checks accepted data: finite, shape, range.
"""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import fuzz_mutations as change
import numpy as np
from fuzz_reader import Reader, finite, written
from fuzz_records import of_campaigns, of_recordings

ROOT = Path(__file__).resolve().parents[2]


def readers(folder: Path, kind: str) -> list[Reader]:
    """Return the readers of a kind of files; `folder` is for temporary files."""
    made = {
        "yaml": (_yaml,),
        "csv": (_calibrated,),
        "npz": (_arrays,),
        "npy": (_pictures,),
        "picture": (_pictures,),
        "mcap": (of_recordings,),
        "json": (of_recordings, of_campaigns),
        "parquet": (of_campaigns,),
    }
    return [reader for make in made[kind] for reader in make(folder) if reader.kind == kind]


def _yaml(folder: Path) -> Iterator[Reader]:
    from deltacharger_kinematics import DeltaGeometry
    from deltacharger_kinematics.geometry import LimbAdjustment
    from deltacharger_kinematics.geometry_file import load_geometry, save_geometry
    from deltacharger_lab.campaigns.scene import load_campaign_scene
    from deltacharger_scenes.scene import SceneError, load_scene
    from deltacharger_tactile.calibration.rig import SHAPE, TactileCalibration
    from deltacharger_tactile.errors import SensorCalibrationError
    from deltacharger_vision.cameras.camera_info import load_camera_info
    from deltacharger_vision.errors import CameraInfoError, MountError, TerminalError
    from deltacharger_vision.mount import Mount
    from deltacharger_vision.terminal import Terminal

    fitted = LimbAdjustment(**{item.name: 1e-4 for item in dataclasses.fields(LimbAdjustment)})
    limbs = fitted, LimbAdjustment(), LimbAdjustment()
    geometry = [written(folder, "g.yaml", lambda path: save_geometry(DeltaGeometry(limbs=limbs), path, "fitted"))]
    scenes = [path.read_bytes() for path in sorted((ROOT / "config" / "scenes").glob("*.yaml"))]
    campaigns = [path.read_bytes() for path in sorted((ROOT / "lab" / "deltacharger_lab" / "scenes").glob("*.yaml"))]
    campaigns = [each for each in campaigns if len(each) < 2000]  # a long list of dockings is only slower
    pads = TactileCalibration(dead=np.arange(200).reshape(SHAPE) == 7, bias=np.array([1e-4, 0.0, 1e-3]), rig=3)
    mount = [written(folder, "m.yaml", Mount.default().save)]
    terminal = [b"bar_length: 0.07\ngap: 7.4e-3  # m\n", b"{bar_height: 0.01, bar_thickness: 0.006}\n"]
    camera = [
        b"image_width: 64\nimage_height: 40\ncamera_name: c\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
        b"  data: [50.0, 0.0, 31.5, 0.0, 50.0, 19.5, 0.0, 0.0, 1.0]\ndistortion_model: plumb_bob\n"
        b"distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0.1, -0.2, 0.0, 0.0, 0.05]\n",
        b"header: {frame_id: c}\nheight: 40\nwidth: 64\ndistortion_model: ''\nd: []\n"
        b"k: [50.0, 0.0, 31.5, 0.0, 50.0, 19.5, 0.0, 0.0, 1.0]\nbinning_x: 0\nroi: {x_offset: 0}\n---\nheight: 1\n",
    ]

    def reader(name: str, good: Sequence[bytes], read: Any, refusals: Any, sound: Any) -> Reader:
        return Reader(name, "yaml", f"{name}.yaml", good, read, (*refusals, OSError), sound, change.TEXT)

    def sound_mount(found: Any) -> None:
        finite(found.pose, found.covariance)
        assert np.allclose(found.pose[:3, :3] @ found.pose[:3, :3].T, np.eye(3), atol=1e-5)

    def sound_pads(found: Any) -> None:
        finite(found.gain, found.bias, found.bias_stddev, found.load_shift)
        assert found.gain.shape == found.dead.shape == SHAPE
        assert ((found.gain >= 0.2) & (found.gain <= 5.0)).all()

    def sound_campaign(found: Any) -> None:
        finite(*(spread.ends for spread in found.spreads.values() if spread.key.kind is not str))
        assert isinstance(found.name, str)

    def sound_scene(found: Any) -> None:
        assert found.nodes
        assert all(isinstance(text, str) for text in (found.name, found.description, *found.nodes))

    def sound_geometry(found: Any) -> None:
        lengths = {name: value for name, value in vars(found).items() if name != "limbs"}
        finite(*lengths.values())
        finite(*(value for limb in found.limbs for value in vars(limb).values() if value is not None))
        assert len(found.limbs) == 3

    yield reader("geometry", geometry, load_geometry, (ValueError,), sound_geometry)
    yield reader("scene", scenes, load_scene, (SceneError,), sound_scene)
    yield reader("campaign", campaigns, lambda path: load_campaign_scene(str(path)), (SceneError,), sound_campaign)
    pads_file = [written(folder, "p.yaml", pads.save)]
    yield reader("pads", pads_file, TactileCalibration.load, (SensorCalibrationError,), sound_pads)
    info = reader("camera_info", camera, load_camera_info, (CameraInfoError,), lambda found: finite(found.matrix()))
    yield info
    yield reader("mount", mount, Mount.load, (MountError,), sound_mount)
    yield reader("terminal", terminal, Terminal.load, (TerminalError,), lambda found: finite(*vars(found).values()))


def _calibrated(folder: Path) -> Iterator[Reader]:
    from deltacharger_bringup.calibrate.camera_views import ViewsError, read_rows
    from deltacharger_kinematics import DeltaGeometry
    from deltacharger_kinematics.calibration.data import Encoder, read_measurements
    from deltacharger_kinematics.calibration.plan import plan, read_plan, write_plan
    from deltacharger_kinematics.calibration.recording import PoseRecording
    from deltacharger_kinematics.calibration.table import CalibrationError

    rows = [b"1,2,3,2048,2100,2000", b"-4.5,6,70,2030,2111,2001", b"0,0,80,2100,2050,2077"]
    table = b"x_mm,y_mm,z_mm,ticks_0,ticks_1,ticks_2\n" + b"\n".join(rows)
    german = b"x_mm;y_mm;z_mm;angle_0_deg;angle_1_deg;angle_2_deg;held_out\n1,5;2;70,0;30,1;31;32,5;0\n"
    states = b"# zero_ticks 2048 2048 2048\n# direction 1 1 1\n" + table
    planned = written(
        folder, "plan.csv", lambda path: write_plan(path, plan(DeltaGeometry())[:4], DeltaGeometry(), Encoder())
    )
    recording = PoseRecording(folder / "recording.csv", Encoder())
    for pose in plan(DeltaGeometry())[:3]:
        recording.append(pose, (2048.0, 2100.5, 2000.0), pose.position)
    recorded = (folder / "recording.csv").read_bytes()
    views = b"image,x_m,y_m,z_m\nview_1.png,0.0,0.01,0.08\nview_2.png,0.01,0.0,0.07\n"

    def reader(name: str, good: Sequence[bytes], read: Any, sound: Any, *refusals: Any, **about: Any) -> Reader:
        kinds = (CalibrationError, OSError, *refusals)
        return Reader(name, "csv", f"{name}.csv", good, read, kinds, sound, change.TEXT, names=False, **about)

    def sound_poses(found: Any) -> None:
        finite(found.positions, found.angles)
        assert found.positions.shape == found.angles.shape == (len(found.lines), 3)

    yield reader("measurements", [table, german, states], read_measurements, sound_poses)
    yield reader("plan", [planned], read_plan, lambda found: finite(*(pose.position for pose in found)))
    yield reader(
        "pose_recording",
        [recorded],
        lambda path: PoseRecording(path, Encoder()),
        lambda found: finite(list(found.done)),
    )
    rows_of = lambda found: finite(*(row.position or row.angles for row in found))  # noqa: E731
    yield reader("views", [views], lambda path: read_rows(path.parent), rows_of, ViewsError)


def _arrays(folder: Path) -> Iterator[Reader]:
    from deltacharger_lab.training.classifier import write
    from deltacharger_sim.pads.generator import generate_paper
    from deltacharger_tactile import MODEL_PATH, default_model
    from deltacharger_tactile.classifiers.classifier import Classifier
    from deltacharger_tactile.dataset import Dataset
    from deltacharger_tactile.errors import DatasetError, ModelError
    from deltacharger_tactile.estimator import PoseEstimator
    from deltacharger_tactile.perception import Perception

    random = np.random.default_rng(1)
    about = {"name": "logistic", "target": "vertical", "threshold": 0.5, "kind": "linear", "seed": 1}
    linear = {"weights": random.normal(size=(200, 5)) * 1e-2, "bias": np.zeros(5)}
    forest = {
        "feature": np.array([3, -1, -1]), "threshold": np.array([0.5, 0.0, 0.0]), "left": np.array([1, 0, 0]),
        "right": np.array([2, 0, 0]), "value": np.full((3, 5), 0.2), "root": np.array([0]), "strict": np.array(False),
    }  # fmt: skip
    neighbours = {"examples": random.uniform(size=(8, 200)), "labels": np.arange(8) % 5, "count": 3, "classes": 5}
    classifiers = [
        written(folder, "c.npz", lambda path, a=a, b=b: write(path, a, b))
        for a, b in (
            (about, linear),
            (about | {"name": "forest", "kind": "forest"}, forest),
            (about | {"name": "knn", "kind": "neighbours"}, {k: np.asarray(v) for k, v in neighbours.items()}),
        )
    ]
    rows = generate_paper(rigs=(320,), seed=5)
    few = {name: value[:6] for name, value in vars(rows).items() if name != "meta"}
    data = [written(folder, "d.npz", Dataset(**few, meta=rows.meta).save)]
    frames, model = np.random.default_rng(2).uniform(0.0, 3.0, (2, 10, 10)), default_model()

    def sound_model(found: Any) -> None:
        estimate = found.predict(*frames)
        finite(estimate.left_force)
        if estimate.sure:  # else unknown is NaN, e.g. after a weight of 1e38
            finite(estimate.angle, estimate.vertical, estimate.angle_stddev, estimate.angle_probability)
            assert estimate.in_range

    def sound_classifier(found: Any) -> None:
        estimate = Perception(model, None, {found.target: found}).predict(*frames)
        for shares in (estimate.angle_probability, estimate.vertical_probability, estimate.horizontal_probability):
            finite(shares)
            assert abs(shares.sum() - 1.0) < 1e-5

    def sound_data(found: Any) -> None:
        finite(found.left, found.right, found.angle, found.vertical, found.horizontal)
        assert found.left.shape == found.right.shape == (len(found.angle), 10, 10)

    def reader(name: str, good: Sequence[bytes], read: Any, refusal: Any, sound: Any) -> Reader:
        inside = change.zip_members(change.any_of(*change.BYTES, change.token))
        return Reader(
            name, "npz", f"{name}.npz", good, read, (refusal, OSError), sound, (*change.BYTES, *(inside,) * 12)
        )

    yield reader("classifier", classifiers, Classifier.load, ModelError, sound_classifier)
    yield reader("data_set", data, Dataset.load, DatasetError, sound_data)
    yield reader("model", [MODEL_PATH.read_bytes()], PoseEstimator.load, ModelError, sound_model)


def _pictures(folder: Path) -> Iterator[Reader]:
    import cv2

    from deltacharger_vision.errors import ImageError
    from deltacharger_vision.image_files import read_color, read_rgbd
    from deltacharger_vision.images import Intrinsics

    cv2.setNumThreads(1)
    camera, random = Intrinsics(32, 20, 25.0, 25.0, 15.5, 9.5), np.random.default_rng(3)
    colors = random.integers(0, 255, (20, 32, 3), dtype=np.uint8)
    depth = random.integers(200, 900, (20, 32), dtype=np.uint16)

    def encoded(suffix: str, pixels: Any) -> bytes:
        return bytes(cv2.imencode(suffix, pixels)[1])

    def saved(array: Any) -> bytes:
        out = io.BytesIO()
        np.save(out, array)
        return out.getvalue()

    progressive = bytes(cv2.imencode(".jpg", colors, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1])
    shades = [colors, colors[:, :, 0], np.dstack([colors, colors[:, :, 0]]), depth]
    pictures = [*(encoded(".png", each) for each in shades), encoded(".jpg", colors), progressive]
    arrays = [saved(depth), saved(depth * np.float32(1e-3)), saved(np.asfortranarray(depth * 1e-3))]
    beside = {"c.png": encoded(".png", colors)}

    def sound_color(found: Any) -> None:
        assert found.dtype in (np.uint8, np.uint16)
        assert found.ndim == 2 or found.shape[2] in (3, 4)

    def sound_depth(found: Any) -> None:
        known = found.depth[np.isfinite(found.depth)]
        assert found.depth.shape == (20, 32)
        assert (known > 0.0).all()

    def with_depth(path: Path) -> Any:
        return read_rgbd(path.parent / "c.png", path, camera)

    again = (*change.BYTES, *(change.png_again,) * 6)
    yield Reader("color", "picture", "a.png", pictures, read_color, (ImageError, OSError), sound_color, again)
    refusals = ImageError, OSError
    yield Reader("depth", "picture", "d.png", [pictures[-3]], with_depth, refusals, sound_depth, again, beside)
    numbers = (*change.BYTES, change.token, change.token, change.claim)
    yield Reader("depth_array", "npy", "d.npy", arrays, with_depth, refusals, sound_depth, numbers, beside)
