# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate camera` on rendered views with a known mount, and on wrong input."""

import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from deltacharger_bringup.cli.camera_views import VIEWS, ViewsError, ViewsFolder, read_rows
from deltacharger_vision import image_files, images
from deltacharger_vision.mount import Mount
from deltacharger_vision.rendering.camera import OAK_D

from ..vision.hand_eye_rig import Rig, squared
from .command import Capture, answer, refuses, run

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

COUNT = 9


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig(1)


@pytest.fixture(scope="module")
def taken(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of views."""
    return rig.write(tmp_path_factory.mktemp("views") / "taken", COUNT)


@pytest.fixture
def blank(tmp_path: Path) -> Path:
    """A folder of views that show nothing."""
    folder = ViewsFolder(tmp_path / "views", OAK_D)
    for number in range(COUNT):
        folder.add(np.zeros((400, 640, 3), dtype=np.uint8), (0.1 * number, 0.0, 0.0))
    return tmp_path / "views"


def line(rig: Rig, folder: Path, *more: object) -> list[str]:
    words = ["calibrate", "camera", "--views", str(folder)]
    for axis, value in zip("xyz", rig.offset, strict=True):
        words += [f"--board-{axis}-mm", f"{1e3 * value}"]
    return words + [str(word) for word in more]


def rewrite(folder: Path, lines: list[str]) -> None:
    (folder / VIEWS).write_text("\n".join(lines) + "\n", encoding="utf-8")


def lines_of(folder: Path) -> list[str]:
    return (folder / VIEWS).read_text(encoding="utf-8").splitlines()


@pytest.mark.rest
def test_views_give_the_mount_within_its_covariance_and_a_usable_file(
    capsys: Capture, rig: Rig, taken: Path, tmp_path: Path
) -> None:
    out = tmp_path / "mount.yaml"
    out.write_text("mine", encoding="utf-8")
    refuses(capsys, shlex.join(line(rig, taken, "--out", out)), "--force")
    assert out.read_text(encoding="utf-8") == "mine"
    code, _, err = run(capsys, *line(rig, taken, "--out", out, "--force"))
    assert (code, str(out) in err) == (0, True), err
    mount = Mount.load(out)
    assert squared(rig.error(mount), mount.covariance) < 25.0
    assert np.linalg.norm(rig.dock_error(mount)) < 0.003
    about = yaml.safe_load(out.read_text(encoding="utf-8"))["calibration"]
    assert (about["images"], about["doubts"], about["held_out_rms"] < 0.001) == (COUNT, [], True)


def test_a_board_is_drawn_for_printing(capsys: Capture, tmp_path: Path) -> None:
    drawing = tmp_path / "board.svg"
    words = ("calibrate", "camera", "--print", drawing, "--size-mm", 60)
    code, found = answer(capsys, *words)
    assert (code, found["size"]) == (0, pytest.approx(0.060))
    assert drawing.read_text(encoding="utf-8").startswith("<svg")
    assert [run(capsys, *words, *force)[0] for force in ((), ("--force",))] == [2, 0]


@pytest.mark.rest
def test_a_wrong_size_is_named_and_nothing_is_written_without_force(
    capsys: Capture, rig: Rig, taken: Path, tmp_path: Path
) -> None:
    out = tmp_path / "mount.yaml"
    words = line(rig, taken, "--size-mm", 50, "--out", out)
    code, found = answer(capsys, *words)
    assert (code, out.exists()) == (1, False)
    doubt = found["doubts"][0]
    assert float(doubt.split("size is ")[1].split()[0]) == pytest.approx(40.0, abs=0.4)
    assert run(capsys, *words, "--force")[0] == 0
    assert yaml.safe_load(out.read_text(encoding="utf-8"))["calibration"]["doubts"] == [doubt]


def shrunk(folder: Path) -> None:
    cv2.imwrite(str(folder / "view_002.png"), np.zeros((800, 1280, 3), dtype=np.uint8))


TABLES: dict[str, Callable[[list[str]], list[str]]] = {
    "give the columns image": lambda lines: ["image,angle_0_rad"],
    "view_999.png": lambda lines: [*lines, lines[-1].replace("view_009", "view_999")],
    "same folder": lambda lines: [*lines, "../x.png,0,0,0"],
    "angle_0_rad is 'nan'": lambda lines: [lines[0], "view_001.png,nan,0,0"],
    "the arm cannot": lambda lines: [lines[0], "view_001.png,1.4,1.7,1.5"],
}
FOLDERS: dict[str, Callable[[Path], object]] = {
    "1280 × 800": shrunk,
    "is not an image": lambda folder: (folder / "view_002.png").write_bytes(b"no image"),
    "camera_info.yaml": lambda folder: (folder / "camera_info.yaml").unlink(),
    "views.csv": lambda folder: (folder / VIEWS).unlink(),
}


@pytest.mark.parametrize("noun", [*TABLES, *FOLDERS])
def test_a_wrong_folder_is_refused(capsys: Capture, rig: Rig, blank: Path, noun: str) -> None:
    if noun in TABLES:
        rewrite(blank, TABLES[noun](lines_of(blank)))
    else:
        FOLDERS[noun](blank)
    refuses(capsys, shlex.join(line(rig, blank)), noun)


def test_a_missing_geometry_and_images_without_a_board_are_refused(capsys: Capture, rig: Rig, blank: Path) -> None:
    refuses(capsys, shlex.join(line(rig, blank, "--geometry", "none.yaml")), "none.yaml")
    refuses(capsys, shlex.join(line(rig, blank)), "sharp", 1)


def test_a_folder_resumes_only_with_the_same_settings(blank: Path, tmp_path: Path) -> None:
    folder = ViewsFolder(blank, OAK_D)
    assert len(folder.angles) == COUNT
    assert folder.add(np.zeros((400, 640, 3), dtype=np.uint8), (0.1, 0.2, 0.3)) == "view_010.png"
    assert read_rows(blank)[-1].angles == pytest.approx((0.1, 0.2, 0.3))
    assert image_files.load_camera_info(blank / "camera_info.yaml") == OAK_D
    with pytest.raises(ViewsError, match="other intrinsics"):
        ViewsFolder(blank, images.Intrinsics(640, 400, 440.0, 441.0, 319.5, 199.5))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "photo.png").touch()
    with pytest.raises(ViewsError, match="other files"):
        ViewsFolder(tmp_path / "other", OAK_D)
    rewrite(blank, [lines_of(blank)[0], "photo.png,0,0,0"])
    with pytest.raises(ViewsError, match="--take"):
        ViewsFolder(blank, OAK_D)
