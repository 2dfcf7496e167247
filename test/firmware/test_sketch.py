# SPDX-License-Identifier: Apache-2.0
"""The sketch for the OpenCM 9.04, compiled without a warning in every form with an Arduino core that does nothing."""

import re

import pytest

from .build import make, once

FORMS = 8  # nothing or everything wired, servos elsewhere or on the board, link by UART or USB


@pytest.mark.rest
def test_every_form_of_the_sketch_links_and_fits(arm_compiler: str) -> None:
    folder = once("sketches", arm_compiler, lambda folder: make(folder, "arm"))
    sizes = re.findall(r"^(\S+)\.elf +flash +(\d+), static RAM +(\d+) bytes$", make(folder, "arm"), re.MULTILINE)
    flash = {name: int(size) for name, size, _ in sizes}
    assert len(flash) == FORMS
    for servos in "servos0", "servos1":
        assert flash[f"wired-{servos}-usb0"] > flash[f"bare-{servos}-usb0"]
    assert flash["wired-servos1-usb0"] > flash["wired-servos0-usb0"]
    for limit in ("FLASH_LEFT", "RAM_LEFT"):
        with pytest.raises(AssertionError, match="static RAM"):
            make(folder, "arm", f"{limit}=4000")
