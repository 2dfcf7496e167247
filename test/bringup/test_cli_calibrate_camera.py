# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate camera` on rendered views with a known mount, and on wrong input."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from deltacharger_bringup.calibrate.camera_views import VIEWS, ViewsError, ViewsFolder, read_rows
from deltacharger_bringup.cli.output import DONE, FAILED, WRONG_INPUT
from deltacharger_vision.cameras.camera_info import load_camera_info
from deltacharger_vision.hand_eye.board import AprilTag
from deltacharger_vision.images import Intrinsics
from deltacharger_vision.mount import Mount
from deltacharger_vision.rendering.camera import OAK_D

from ..vision.hand_eye_rig import ARM, Rig, squared
from . import command

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

COUNT = 10


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig(1)


@pytest.fixture(scope="module")
def taken(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of views, read-only."""
    return rig.write(tmp_path_factory.mktemp("views") / "taken", COUNT)


@pytest.fixture
def views(taken: Path, tmp_path: Path) -> Path:
    """A folder of views that a test may change."""
    return Path(shutil.copytree(taken, tmp_path / "views"))


def offset(rig: Rig) -> list[str]:
    return [
        word for axis, value in zip("xyz", rig.offset, strict=True) for word in (f"--board-{axis}-mm", f"{1e3 * value}")
    ]


def run(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    return command.run(capsys, "calibrate", "camera", *words)


def rewrite(folder: Path, lines: list[str]) -> None:
    (folder / VIEWS).write_text("\n".join(lines) + "\n", encoding="utf-8")


def lines_of(folder: Path) -> list[str]:
    return (folder / VIEWS).read_text(encoding="utf-8").splitlines()


def test_views_give_the_mount_within_its_covariance_and_a_usable_file(
    capsys: pytest.CaptureFixture[str], rig: Rig, taken: Path, tmp_path: Path
) -> None:
    out = tmp_path / "mount.yaml"
    code, text, err = run(capsys, "--views", taken, *offset(rig), "--out", out)
    assert code == DONE, err
    assert f"wrote {out}" in err
    for word in ("position", "orientation", "at the dock", "reprojection", "held out", "2 images", "board size"):
        assert word in text
    assert max(map(len, text.splitlines())) <= 120
    mount = Mount.load(out)
    assert squared(rig.error(mount), mount.covariance) < 25.0
    assert np.linalg.norm(rig.dock_error(mount)) < 0.003
    about = yaml.safe_load(out.read_text(encoding="utf-8"))["calibration"]
    assert (about["board"], about["images"], about["held_out"], about["doubts"]) == ("apriltag:36h11:0", COUNT, 2, [])
    assert about["held_out_rms"] < 0.001
    assert about["board_offset"] == pytest.approx(rig.offset, abs=1e-6)


def test_one_object_in_si_units(capsys: pytest.CaptureFixture[str], rig: Rig, taken: Path) -> None:
    code, text, _ = run(capsys, "--views", taken, *offset(rig), "--json", "--board-stddev-mm", 0.2)
    found = json.loads(text)
    assert (code, found["success"], found["written"]) == (DONE, True, None)
    mount = Mount(Mount.from_numbers([*found["position"], *found["orientation"]]).pose, np.array(found["covariance"]))
    assert np.linalg.norm(rig.error(mount)[3:]) < math.radians(0.5)
    assert found["covariance"][0][0] >= 0.0002**2
    assert found["held_out"]["images"] == ["view_005.png", "view_010.png"]
    assert found["held_out"]["rms"] < 5e-4
    assert found["reprojection_rms"] < 1.0
    assert found["residual"]["largest"] < 5e-4
    assert found["size"]["factor"] == pytest.approx(1.0, abs=0.01)
    assert found["left_out"] == found["without_board"] == found["doubts"] == []
    assert any("few" in note for note in found["notes"])


def test_positions_and_angles_give_the_same_mount(capsys: pytest.CaptureFixture[str], rig: Rig, views: Path) -> None:
    _, text, _ = run(capsys, "--views", views, *offset(rig), "--json")
    by_angles = json.loads(text)
    rows = read_rows(views)
    places = [ARM.forward(*row.angles) for row in rows if row.angles is not None]
    assert len(places) == COUNT
    cells = [",".join([row.image, *(f"{1e3 * v:.6f}" for v in place)]) for row, place in zip(rows, places, strict=True)]
    rewrite(views, ["# by hand", "image,x_mm,y_mm,z_mm", *cells])
    code, text, _ = run(capsys, "--views", views, *offset(rig), "--json")
    assert code == DONE
    np.testing.assert_allclose(json.loads(text)["position"], by_angles["position"], atol=1e-6)


def test_a_charuco_board_end_to_end(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    from deltacharger_vision.hand_eye.board import Charuco

    rig = Rig(2, Charuco())
    folder = rig.write(tmp_path / "views", 7)
    words = ("--board", "charuco:4x4_50:5x4", "--size-mm", 12, "--marker-mm", 9)
    code, text, err = run(capsys, "--views", folder, *words, *offset(rig), "--json")
    assert code == DONE, err
    found = json.loads(text)
    mount = Mount(Mount.from_numbers([*found["position"], *found["orientation"]]).pose, np.array(found["covariance"]))
    assert squared(rig.error(mount), mount.covariance) < 25.0


def test_a_board_is_drawn_for_printing(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    drawing = tmp_path / "board.svg"
    words = ("--print", drawing, "--board", "charuco:4x4_50:5x4", "--size-mm", 12)
    code, text, err = run(capsys, *words, "--json")
    assert code == DONE
    assert json.loads(text)["pattern"] == pytest.approx([0.060, 0.048])
    assert "60 × 48 mm" in err
    assert drawing.read_text(encoding="utf-8").startswith("<svg")
    assert run(capsys, *words)[0] == WRONG_INPUT
    assert run(capsys, *words, "--force")[0] == DONE
    assert run(capsys, "--print", tmp_path / "board.pdf")[0] == WRONG_INPUT
    assert "--views" in run(capsys)[2]


def test_the_offset_must_be_given(capsys: pytest.CaptureFixture[str], taken: Path) -> None:
    code, _, err = run(capsys, "--views", taken, "--board-x-mm", 20)
    assert code == WRONG_INPUT
    assert "--board-y-mm, --board-z-mm" in err
    assert "ruler" in err


def test_a_wrong_sign_of_the_offset_is_detected_by_the_believed_mount(
    capsys: pytest.CaptureFixture[str], rig: Rig, taken: Path, tmp_path: Path
) -> None:
    words = offset(rig)
    words[1] = str(-float(words[1]))
    code, text, err = run(capsys, "--views", taken, *words, "--json")
    assert code == DONE
    assert json.loads(text)["from_believed"]["distance"] == pytest.approx(2 * rig.offset[0], abs=0.008)
    assert "the signs of --board" in err
    believed = tmp_path / "believed.yaml"
    Mount(rig.mount, np.eye(6)).save(believed)
    _, text, err = run(capsys, "--views", taken, *offset(rig), "--mount", believed, "--json")
    assert json.loads(text)["from_believed"]["distance"] < 0.003
    assert "signs" not in err


def test_a_wrong_size_is_named_and_nothing_is_written_without_force(
    capsys: pytest.CaptureFixture[str], rig: Rig, taken: Path, tmp_path: Path
) -> None:
    out = tmp_path / "mount.yaml"
    words = ("--views", taken, *offset(rig), "--size-mm", 50, "--out", out)
    code, text, err = run(capsys, *words, "--json")
    assert code == FAILED
    assert not out.exists()
    doubt = json.loads(text)["doubts"][0]
    assert "measure the print" in doubt
    assert float(doubt.split("size is ")[1].split()[0]) == pytest.approx(40.0, abs=0.4)
    assert doubt in err
    assert "--force" in err
    assert run(capsys, *words, "--force")[0] == DONE
    assert yaml.safe_load(out.read_text(encoding="utf-8"))["calibration"]["doubts"] == [doubt]


def test_a_row_with_the_position_of_another_image_is_left_out(
    capsys: pytest.CaptureFixture[str], rig: Rig, views: Path
) -> None:
    lines = lines_of(views)
    wrong = lines[4].split(",")
    lines[4] = ",".join([wrong[0], *(f"{float(angle) + 0.1:.6f}" for angle in wrong[1:])])
    rewrite(views, lines)
    code, text, _ = run(capsys, "--views", views, *offset(rig), "--json")
    assert code == DONE
    assert json.loads(text)["left_out"] == ["view_004.png"]


def test_images_without_the_board_are_reported(capsys: pytest.CaptureFixture[str], rig: Rig, views: Path) -> None:
    assert cv2.imwrite(str(views / "view_003.png"), np.full((400, 640, 3), 90, dtype=np.uint8))
    code, text, err = run(capsys, "--views", views, *offset(rig), "--json")
    assert code == DONE
    assert json.loads(text)["without_board"] == ["view_003.png"]
    assert "1 of 10 images do not show the board: view_003.png" in err


@pytest.mark.parametrize(
    ("board", "hint"),
    [
        ("apriltag:36h11:3", "apriltag 36h11 0"),
        ("apriltag:25h9:0", "apriltag 36h11 0"),
        ("charuco:4x4_50:5x4", "36h11"),
    ],
)
def test_another_board_is_named_if_no_image_shows_the_given_one(
    capsys: pytest.CaptureFixture[str], rig: Rig, taken: Path, board: str, hint: str
) -> None:
    code, text, err = run(capsys, "--views", taken, *offset(rig), "--board", board, "--json")
    assert code == FAILED
    assert f"none of 10 images shows {board}" in err
    assert hint in err
    assert json.loads(text)["success"] is False


def test_no_board_in_any_image(capsys: pytest.CaptureFixture[str], rig: Rig, views: Path) -> None:
    for path in views.glob("*.png"):
        assert cv2.imwrite(str(path), np.full((400, 640), 90, dtype=np.uint8))
    code, _, err = run(capsys, "--views", views, *offset(rig))
    assert code == FAILED
    assert "sharp" in err


def test_too_few_views_and_one_line_are_refused(capsys: pytest.CaptureFixture[str], rig: Rig, views: Path) -> None:
    lines = lines_of(views)
    rewrite(views, lines[:5])
    code, _, err = run(capsys, "--views", views, *offset(rig))
    assert code == WRONG_INPUT
    assert "4 views show the board" in err
    names = [line.split(",")[0] for line in lines[1:]]
    rewrite(views, ["image,x_mm,y_mm,z_mm", *(f"{name},{10 * n - 50},0,20" for n, name in enumerate(names))])
    code, _, err = run(capsys, "--views", views, *offset(rig))
    assert code == WRONG_INPUT
    assert "along one line, x" in err


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda lines: [], "is empty"),
        (lambda lines: ["image,x_mm,y_mm"], "one of x_mm,y_mm,z_mm"),
        (lambda lines: ["picture,angle_0_rad,angle_1_rad,angle_2_rad", *lines[1:]], "unknown column 'picture'"),
        (lambda lines: ["image,x_mm,y_mm,z_mm,angle_0_rad"], "one of x_mm,y_mm,z_mm"),
        (lambda lines: [*lines, "view_011.png,1,2"], "line 12: 3 cells for 4 columns"),
        (lambda lines: [*lines, lines[-1].replace("view_010", "view_999")], "line 12: there is no image view_999.png"),
        (lambda lines: [*lines, lines[1]], "line 12: image view_001.png is already in line 2"),
        (lambda lines: [*lines, "../x.png,0,0,0"], "file of the same folder"),
        (lambda lines: [*lines, "x.txt,0,0,0"], "file of the same folder"),
        (lambda lines: [lines[0], "view_001.png,nan,0,0"], "line 2: angle_0_rad is 'nan'"),
        (lambda lines: ["image,x_m,y_m,z_m", "view_001.png,0,0,20"], "line 2: the arm cannot have the position"),
        (lambda lines: ["image,x_mm,y_mm,z_mm", "view_001.png,0,0,900"], "line 2: the arm cannot have the position"),
    ],
)
def test_a_wrong_table_is_refused_with_its_line(
    capsys: pytest.CaptureFixture[str], rig: Rig, views: Path, change: object, what: str
) -> None:
    assert callable(change)
    rewrite(views, change(lines_of(views)))
    code, _, err = run(capsys, "--views", views, *offset(rig))
    assert code == WRONG_INPUT
    assert what in err
    assert VIEWS in err


def test_images_and_intrinsics_must_be_of_one_size(capsys: pytest.CaptureFixture[str], rig: Rig, views: Path) -> None:
    image = cv2.imread(str(views / "view_002.png"))
    assert cv2.imwrite(str(views / "view_002.png"), cv2.resize(image, (1280, 800)))
    code, _, err = run(capsys, "--views", views, *offset(rig))
    assert code == WRONG_INPUT
    assert "view_002.png" in err
    assert "1280 × 800" in err
    (views / "view_002.png").write_bytes(b"no image")
    code, _, err = run(capsys, "--views", views, *offset(rig))
    assert code == WRONG_INPUT
    assert "is not an image" in err


def test_missing_files_are_named(capsys: pytest.CaptureFixture[str], rig: Rig, views: Path, tmp_path: Path) -> None:
    assert "views.csv" in run(capsys, "--views", tmp_path, *offset(rig))[2]
    (views / "camera_info.yaml").unlink()
    code, _, err = run(capsys, "--views", views, *offset(rig))
    assert code == WRONG_INPUT
    assert "--camera-info" in err
    assert run(capsys, "--views", views, *offset(rig), "--camera-info", tmp_path / "no.yaml")[0] == WRONG_INPUT
    assert run(capsys, "--views", views, *offset(rig), "--geometry", tmp_path / "no.yaml")[0] == WRONG_INPUT


def test_an_over_exposed_tag_is_noted(capsys: pytest.CaptureFixture[str], rig: Rig, views: Path) -> None:
    for path in views.glob("*.png"):
        assert cv2.imwrite(str(path), np.clip(cv2.imread(str(path)).astype(float) * 1.7, 0, 255).astype(np.uint8))
    code, text, _ = run(capsys, "--views", views, *offset(rig), "--json")
    assert code in (DONE, FAILED)
    assert any("over-exposed" in note for note in json.loads(text)["notes"])


def test_nothing_is_overwritten_without_force(
    capsys: pytest.CaptureFixture[str], rig: Rig, taken: Path, tmp_path: Path
) -> None:
    out = tmp_path / "mount.yaml"
    out.write_text("mine", encoding="utf-8")
    code, _, err = run(capsys, "--views", taken, *offset(rig), "--out", out)
    assert (code, out.read_text(encoding="utf-8")) == (WRONG_INPUT, "mine")
    assert "--force" in err
    assert run(capsys, "--views", taken, *offset(rig), "--out", tmp_path / "no" / "mount.yaml")[0] == WRONG_INPUT


@pytest.mark.parametrize(
    "words",
    [
        ("--board", "chess"),
        ("--board", "apriltag:36h11:9999"),
        ("--size-mm", "nan"),
        ("--size-mm", "0"),
        ("--marker-mm", "30"),
        ("--board-stddev-mm", "-1"),
        ("--board-x-mm", "1e9"),
        ("--held-out-every", "1"),
        ("--take", "3"),
        ("--z-max-mm", "500"),
    ],
)
def test_options_have_bounds(capsys: pytest.CaptureFixture[str], rig: Rig, taken: Path, words: tuple[str, ...]) -> None:
    assert run(capsys, "--views", taken, *offset(rig), *words)[0] == WRONG_INPUT


def test_a_folder_resumes_only_with_the_same_settings(taken: Path, views: Path, tmp_path: Path) -> None:
    folder = ViewsFolder(views, OAK_D)
    assert len(folder.angles) == COUNT
    assert folder.add(np.zeros((400, 640, 3), dtype=np.uint8), (0.1, 0.2, 0.3)) == "view_011.png"
    assert read_rows(views)[-1].angles == pytest.approx((0.1, 0.2, 0.3))
    assert load_camera_info(views / "camera_info.yaml") == OAK_D
    with pytest.raises(ViewsError, match="other intrinsics"):
        ViewsFolder(views, Intrinsics(640, 400, 440.0, 441.0, 319.5, 199.5))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "photo.png").touch()
    with pytest.raises(ViewsError, match="other files"):
        ViewsFolder(tmp_path / "other", OAK_D)
    rewrite(views, ["image,x_mm,y_mm,z_mm", "view_001.png,0,0,20"])
    with pytest.raises(ViewsError, match="not filled by --take"):
        ViewsFolder(views, OAK_D)


def test_distortion_is_stored_and_loaded(tmp_path: Path) -> None:
    for distortion in ((-0.1, 0.02, 0.001, -0.002, 0.0), (6.5, -3.1, 0.0, 0.0, 0.9, 6.7, -2.4, 0.6)):
        lens = Intrinsics(640, 400, 441.0, 440.0, 319.5, 199.5, distortion)
        folder = tmp_path / str(len(distortion))
        ViewsFolder(folder, lens)
        assert load_camera_info(folder / "camera_info.yaml") == lens


def test_positions_fill_the_visible_workspace() -> None:
    rig = Rig(3, AprilTag())
    places = np.array([place for (place, _), _ in zip(rig.stands(), range(20), strict=False)])
    assert (np.ptp(places, axis=0) > (0.07, 0.06, 0.04)).all()
    assert (np.abs(places[:, :2]) < 0.06).all()
    assert (places[:, 2] < 0.06).all()
