# SPDX-License-Identifier: Apache-2.0
"""From light to pixel values: blur, uneven light, exposure, noise and sRGB encoding."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array32

_LEVELS = 4096
_KNOTS = (6, 9)


def developed(
    light: Array32, exposure: float, shot_noise: float, read_noise: float, random: np.random.Generator
) -> NDArray[np.uint8]:
    """Return (H, W, 3) uint8 sRGB of light (3, H, W): exposed, with noise, saturated at 1. Modifies `light`.

    The noise's variance is read_noise² + shot_noise² · light, relative to full scale.
    """
    image = np.empty((*light.shape[1:], 3), dtype=np.uint8)
    encoding, spread = _encoding(), np.empty_like(light[0])
    # One colour at a time, so that arrays stay in the processor's cache.
    for channel, plane in enumerate(light):
        if exposure != 1.0:
            plane *= np.float32(exposure)
        if shot_noise or read_noise:
            np.clip(plane, 0.0, 1.0, out=spread)
            spread *= np.float32(shot_noise**2)
            spread += np.float32(read_noise**2)
            np.sqrt(spread, out=spread)
            spread *= white(plane.shape, random)
            plane += spread
        plane *= np.float32(_LEVELS - 1)
        plane += np.float32(0.5)
        np.clip(plane, 0, _LEVELS - 1, out=plane)
        image[:, :, channel] = encoding[plane.astype(np.uint16)]
    return image


@cache
def _encoding() -> NDArray[np.uint8]:
    """sRGB (IEC 61966-2-1) of light 0…1 in `_LEVELS` steps."""
    light = np.arange(_LEVELS) / (_LEVELS - 1)
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * encoded), dtype=np.uint8)


def blurred(light: Array32, defocus: float, motion_x: float, motion_y: float) -> Array32:
    """Return light (3, H, W) blurred by a Gaussian of `defocus` px and a straight movement (px)."""
    if not defocus and not motion_x and not motion_y:
        return light
    margin = math.ceil(3 * defocus + max(abs(motion_x), abs(motion_y))) + 1
    wide = np.pad(light, ((0, 0), (margin, margin), (margin, margin)), mode="edge")
    down = np.fft.fftfreq(wide.shape[1])[:, None]
    across = np.fft.rfftfreq(wide.shape[2])[None, :]
    transfer = np.exp(-2 * (np.pi * defocus) ** 2 * (across**2 + down**2)) * np.sinc(
        motion_x * across + motion_y * down
    )
    found = np.fft.irfft2(np.fft.rfft2(wide) * transfer.astype(np.float32), s=wide.shape[1:])
    return np.maximum(found[:, margin:-margin, margin:-margin], 0.0).astype(np.float32)


def white(shape: tuple[int, ...], random: np.random.Generator) -> Array32:
    """Return independent noise (shape) of mean 0 and variance 1.

    Each value is a sum of four uniform numbers: normal up to 3.4 standard deviations, in less than half the time.
    """
    count = math.prod(shape)
    words = random.integers(0, 2**64, size=count, dtype=np.uint64).view(np.uint16).reshape(4, count)
    found: Array32 = words[0].astype(np.float32)
    for part in words[1:]:
        found += part
    found -= np.float32(4 * 32767.5)
    found *= np.float32(1.0 / math.sqrt(4 * (65536**2 - 1) / 12))
    return np.asarray(found.reshape(shape))


def slow_field(shape: tuple[int, int], spread: float, random: np.random.Generator) -> Array32:
    """Return (H, W) slowly varying factors 1 ± spread."""
    knots = random.uniform(1.0 - spread, 1.0 + spread, _KNOTS)
    down, across = (_hats(count, size) for count, size in zip(_KNOTS, shape, strict=True))
    return np.asarray(down @ knots.astype(np.float32) @ across.T, dtype=np.float32)


def _hats(count: int, size: int) -> Array32:
    """Return (size, count) weights of linear interpolation between `count` knots."""
    place = np.linspace(0.0, count - 1.0, size)[:, None]
    return np.maximum(0.0, 1.0 - np.abs(place - np.arange(count))).astype(np.float32)
