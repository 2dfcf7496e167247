# SPDX-License-Identifier: Apache-2.0
"""Rules of pyproject.toml and package.xml: few required libraries, each with its reason; a licence on every file."""

import importlib
import re
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from catkin_pkg.package import parse_package_string

from deltacharger_bringup.cli import main as cli
from deltacharger_bringup.scenes import executables

ROOT = Path(__file__).resolve().parents[1]
LICENCE = "SPDX-License-Identifier: Apache-2.0"
SOURCES = (".py", ".c", ".h", ".cpp", ".ino", ".msg", ".srv", ".action", ".xacro", ".j2")
NOT_OURS = ("build", "install", "log")
MANIFEST = ElementTree.parse(ROOT / "package.xml").getroot()
_ROS = (
    *("rclpy", "ament_index_python", "action_msgs", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs"),
    *("sensor_msgs", "std_msgs", "std_srvs", "trajectory_msgs"),
)
HARD = {  # distribution: rosdep key
    "numpy": "python3-numpy",
    "pyyaml": "python3-yaml",
    "pyserial": "python3-serial",
    "dynamixel-sdk": "dynamixel_sdk",
    **{f"ros-{name.replace('_', '-')}": name for name in _ROS},
}
MODULES = {"yaml", "serial", "rcl_interfaces"} | {name for name in HARD if "-" not in name} | set(HARD.values())
VIEW = {"robot_state_publisher", "rviz2", "xacro"}
REPORT = {"python3-matplotlib", "python3-scipy"}
EXTRAS = {"vision": "python3-opencv", "record": "mcap-ros2-support", "mission": "nav2_msgs"}


def project() -> dict[str, Any]:
    toml = importlib.import_module("tomllib" if sys.version_info >= (3, 11) else "pip._vendor.tomli")
    found: dict[str, Any] = toml.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return found


def keys(*tags: str) -> set[str]:
    return {each.text or "" for each in MANIFEST if each.tag in tags}


def asked_for(extras: str = "") -> set[str]:
    """Return the packages that rosdep installs with this value of DELTACHARGER_EXTRAS; colcon reads it the same way."""
    package = parse_package_string((ROOT / "package.xml").read_text(encoding="utf-8"))
    package.evaluate_conditions({"DELTACHARGER_EXTRAS": extras} if extras else {})
    return {each.name for each in package.exec_depends if each.evaluated_condition}


def sources() -> Iterator[Path]:
    for folder in sorted(ROOT.iterdir()):
        if folder.is_dir() and folder.name not in NOT_OURS and not folder.name.startswith((".venv", "report-")):
            yield from (path for path in sorted(folder.rglob("*")) if path.suffix in SOURCES)
    yield ROOT / "setup.py"


def test_required_libraries_are_minimal() -> None:
    required = {each.partition("[")[0] for each in project()["dependencies"]}
    assert required == set(HARD), "none with a version, which rosdep brings"


@pytest.mark.filterwarnings("ignore::DeprecationWarning:catkin_pkg")
def test_without_extras_rosdep_installs_what_docking_by_coordinates_needs() -> None:
    extras = {*EXTRAS.values(), *VIEW, *REPORT}
    assert asked_for() & extras == set()
    assert set(HARD.values()) <= asked_for()
    assert {name: asked_for(name) - asked_for() for name in EXTRAS} == {name: {key} for name, key in EXTRAS.items()}
    assert asked_for("all") - asked_for() == extras


def test_optional_libraries_are_imported_only_when_needed() -> None:
    for path in sorted(ROOT.glob("deltacharger_*/**/*.py")):
        text = path.read_text("utf-8")
        names = re.findall(r"^(?:try:\s+)?(?:from (\w+)[\w.]* import |import (\w+))", text, re.MULTILINE)
        others = {"".join(each) for each in names} - sys.stdlib_module_names - MODULES
        assert not {name for name in others if not name.startswith("deltacharger")}, path


def test_the_error_names_a_missing_extra(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    from deltacharger_bringup.cli import calibrate_kinematics as cli_calibrate

    def fit(options: object) -> int:
        raise ModuleNotFoundError("No module named 'scipy'", name="scipy.optimize")

    monkeypatch.setattr(cli_calibrate, "kinematics", fit)
    assert cli.main(["calibrate", "kinematics", str(tmp_path / "data.csv")]) == 1
    assert "scipy is not installed; install deltacharger[calibrate], or by rosdep" in capsys.readouterr().err
    extras = {each.removeprefix("deltacharger[") for each in cli._EXTRA_OF.values() if each.startswith("deltacharger[")}
    assert extras <= {f"{each}]" for each in project()["optional-dependencies"]}


def listed(path: Path, name: str) -> set[str]:
    """Return the words of a list in a file of CMake."""
    found = re.search(rf"set\({name}\s+([^)]*)\)", path.read_text(encoding="utf-8"))
    assert found is not None
    return set(found[1].split())


def test_interfaces_use_only_dependencies_of_the_manifest() -> None:
    assert listed(ROOT / "CMakeLists.txt", "interface_dependencies") == keys("depend")


def test_colcon_runs_every_folder_that_has_tests_without_ros() -> None:
    found_there = {path.relative_to(ROOT / "test").parts[0] for path in ROOT.glob("test/**/test_*.py")}
    files = {path.name for path in ROOT.glob("test/test_*.py") if "\npytestmark = " in path.read_text(encoding="utf-8")}
    assert listed(ROOT / "test" / "suite.cmake", "tests") == found_there - files, "without folders that need ROS"


def test_every_executable_exists() -> None:
    text = (ROOT / "setup.cfg").read_text(encoding="utf-8")
    found = re.findall(r"^ {4}(\w+) = ([\w.]+:\w+)$", text, re.MULTILINE)
    nodes = {name for name, function in found if function == f"deltacharger_bringup.scenes.executables:{name}"}
    assert sorted(found) == sorted(
        [("deltacharger", "deltacharger_bringup.cli.__main__:main")]
        + [(name, f"deltacharger_bringup.scenes.executables:{name}") for name in nodes]
    )
    modules = executables.modules()
    assert nodes == set(modules)
    for module in modules.values():
        assert "\ndef main(" in (ROOT / (module.replace(".", "/") + ".py")).read_text("utf-8"), module


def test_every_source_begins_with_the_licence() -> None:
    without = []
    for path in sources():
        first, *_ = re.sub(r"^(#!|<\?xml).*\n", "", path.read_text(encoding="utf-8")).splitlines() or [""]
        without += [] if LICENCE in first else [str(path.relative_to(ROOT))]
    assert not without, f"{len(without)} of them, as {without[:5]}: first line '# {LICENCE}' (in C in /* */)"
