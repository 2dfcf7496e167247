# SPDX-License-Identifier: Apache-2.0
"""Images from files: content is preserved, and errors are named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltacharger_vision.errors import ImageError
from deltacharger_vision.image_files import images_in, read_color, read_depth, read_rgbd, write_picture
from deltacharger_vision.images import Intrinsics

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

CAMERA = Intrinsics(64, 40, 50.0, 50.0, 31.5, 19.5)
Array = np.ndarray[Any, Any]


def noise(kind: type, *shape: int) -> Array:
    return np.random.default_rng(5).integers(0, np.iinfo(kind).max, shape, dtype=kind)


def encoded(pixels: Array, suffix: str = ".png") -> bytes:
    """Encode RGB or RGBA with OpenCV."""
    order = [2, 1, 0, 3][: pixels.shape[2]] if pixels.ndim == 3 else None
    return bytes(cv2.imencode(suffix, pixels if order is None else np.ascontiguousarray(pixels[:, :, order]))[1])


def stored(path: Path, pixels: Array) -> Path:
    path.write_bytes(encoded(pixels, path.suffix))
    return path


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(40, 64), (40, 64, 3), (40, 64, 4)], ids=["gray", "rgb", "rgba"])
def test_a_png_keeps_its_pixels_and_the_order_of_its_channels(tmp_path: Path, kind: type, shape: tuple[int]) -> None:
    pixels = noise(kind, *shape)
    found = read_color(stored(tmp_path / "a.png", pixels))
    assert found.dtype == kind
    np.testing.assert_array_equal(found, pixels)


def test_the_rotation_flag_of_a_photograph_is_ignored(tmp_path: Path) -> None:
    """EXIF 6: rotate by 90° for viewing."""
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    plain = encoded(noise(np.uint8, 40, 64, 3), ".jpg")
    path = tmp_path / "a.jpg"
    path.write_bytes(plain[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + plain[2:])
    assert cv2.imread(str(path)).shape == (64, 40, 3)
    assert read_color(path).shape == (40, 64, 3)


def test_depth_keeps_its_values_and_an_rgbd_image_has_metres_and_unknowns(tmp_path: Path) -> None:
    millimetres = noise(np.uint16, 40, 64)
    np.testing.assert_array_equal(read_depth(stored(tmp_path / "a.png", millimetres)), millimetres)
    for array in (millimetres, (millimetres * 1e-3).astype(np.float32), millimetres * 1e-3):
        np.save(tmp_path / "a.npy", array)
        found = read_depth(tmp_path / "a.npy")
        assert found.dtype == array.dtype
        np.testing.assert_array_equal(found, array)
    color = stored(tmp_path / "a.png", noise(np.uint8, 40, 64, 3))
    depth = np.full((40, 64), 1234, dtype=np.uint16)
    depth[0, 0] = 0
    image = read_rgbd(color, stored(tmp_path / "d.png", depth), CAMERA)
    assert np.isnan(image.depth[0, 0])
    np.testing.assert_allclose(image.depth.ravel()[1:], 1.234)
    assert np.isnan(read_rgbd(color, None, CAMERA).depth).all()


@pytest.mark.parametrize(
    ("name", "content", "noun"),
    [
        ("d.png", encoded(noise(np.uint8, 40, 64)), "8 bits"),
        ("d.png", encoded(noise(np.uint16, 40, 64, 3)), "3 × 16"),
        ("d.png", b"", "empty"),
        ("d.png", encoded(noise(np.uint16, 40, 64))[:500], "damaged"),
        ("d.png", encoded(noise(np.uint16, 20, 64)), "64 × 20"),
        ("d.npy", b"no array", "NPY"),
        ("d.npy", b"", "NPY"),
        ("d.npy", [{}], "NPY"),
        ("d.npy", np.full((40, 64), 300.0), "metres"),
        ("d.npy", np.full((40, 64), -0.3), "negative"),
        ("d.npy", np.full((40, 64), 300), "int64"),
        ("a.png", b"", "empty"),
        ("a.png", b"\x89PNG\r\n", "image"),
        ("a.png", encoded(noise(np.uint8, 10, 64)), "10 px"),
        ("a.png", encoded(noise(np.uint8, 64, 64)), "aspect"),
    ],
)
def test_a_wrong_file_is_named(tmp_path: Path, name: str, content: Any, noun: str) -> None:
    color, wrong = stored(tmp_path / "a.png", noise(np.uint8, 40, 64, 3)), tmp_path / name
    if isinstance(content, bytes):
        wrong.write_bytes(content)
    else:
        np.save(wrong, content, allow_pickle=True)
    with pytest.raises(ImageError, match=noun) as refused:
        read_rgbd(color, wrong if wrong != color else None, CAMERA)
    assert str(wrong) in str(refused.value)


@given(st.binary(max_size=300), st.sampled_from((".png", ".npy")), st.booleans())
def test_random_bytes_raise_only_known_errors(
    tmp_path_factory: pytest.TempPathFactory, data: bytes, suffix: str, signed: bool
) -> None:
    signature = {".png": encoded(noise(np.uint16, 4, 4))[:33], ".npy": b"\x93NUMPY\x01\x00"}[suffix]
    path = tmp_path_factory.getbasetemp() / f"any{suffix}"
    path.write_bytes((signature if signed else b"") + data)
    with pytest.raises(ImageError):
        read_depth(path)


def test_a_written_picture_reads_back_unchanged(tmp_path: Path) -> None:
    picture = noise(np.uint8, 40, 64, 3)
    write_picture(tmp_path / "out.PNG", picture)
    np.testing.assert_array_equal(read_color(tmp_path / "out.PNG"), picture)
    with pytest.raises(ImageError, match=r"ends in \.png"):
        write_picture(tmp_path / "out.gif", picture)
    with pytest.raises(OSError, match="nowhere"):
        write_picture(tmp_path / "nowhere" / "out.png", picture)


def touch(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return folder


def test_both_conventions_pair_files_by_name(tmp_path: Path) -> None:
    beside = touch(
        tmp_path / "beside", "b.color.png", "b.depth.npy", "a.color.jpg", "a.depth.png", "c.color.JPEG", "d.depth.png",
        "notes.txt", "e.png", "camera_info.yaml", "a.color.png.txt", "._a.color.png",
    )  # fmt: skip
    found = [(each.name, each.color and each.color.name, each.depth and each.depth.name) for each in images_in(beside)]
    assert found == [
        ("a", "a.color.jpg", "a.depth.png"),
        ("b", "b.color.png", "b.depth.npy"),
        ("c", "c.color.JPEG", None),
        ("d", None, "d.depth.png"),
    ]
    folders = touch(tmp_path / "folders", "color/1.jpg", "depth/1.png", "color/2.png", "color/Thumbs.db")
    assert [(each.name, each.color, each.depth) for each in images_in(folders)] == [
        ("1", folders / "color/1.jpg", folders / "depth/1.png"),
        ("2", folders / "color/2.png", None),
    ]
    assert len(images_in(touch(tmp_path / "bare", "color/1.jpg"))) == 1


@pytest.mark.parametrize(
    ("names", "noun"), [("a.png", "NAME"), ("a.color.png a.color.jpg", "same name"), ("a.depth.png", "no colour")]
)
def test_folders_without_images_or_with_one_twice_are_refused(tmp_path: Path, names: str, noun: str) -> None:
    with pytest.raises(ImageError, match=noun):
        images_in(touch(tmp_path, *names.split()))[0].read(CAMERA)
