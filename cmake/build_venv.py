# SPDX-License-Identifier: Apache-2.0
"""Build a virtual environment that holds deltacharger: python3 cmake/build_venv.py VENV [CONSTRAINTS].

Checks first what building needs. Whatever fails ends in one line that says what to install or to do; what the tools
printed is in VENV/build.log. Runs on Python 3.6 or newer, so that an old one is refused by name.
"""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import time

OLDEST = (3, 10)  # as pyproject.toml
EXTRAS = "calibrate,dev,picture,record,vision"
MIB_NEEDED = 1500  # of the environment and the build folder
CAUSES = (
    (r"No space left on device|Disk quota exceeded", f"the disk is full: free about {MIB_NEEDED} MiB"),
    (
        r"NewConnectionError|NameResolutionError|ConnectTimeout|Temporary failure in name resolution"
        r"|Network is unreachable|Could not find a version that satisfies",
        "pip cannot get the packages: connect to the network, or name an index that is reachable (pip config)",
    ),
    (r"Python\.h: No such file|Could NOT find Python3", "Python has no headers: apt install python3-dev"),
    (
        r"CMAKE_CXX_COMPILER|CMAKE_C_COMPILER|No CMAKE_.*COMPILER could be found",
        "no C++ compiler works: apt install g++",
    ),
)


def missing(folder):
    """Yield what building needs and is not there, a line each."""
    major, minor = sys.version_info[:2]
    version = f"{major}.{minor}"
    if (major, minor) < OLDEST:
        yield f"Python is {version}; 3.10 or newer is needed, first in PATH as python3"
        return
    if not sys.platform.startswith("linux"):
        yield f"this is {sys.platform}; Linux is needed"
    if not all(importlib.util.find_spec(name) for name in ("venv", "ensurepip")):
        yield f"Python {version} has no venv: apt install python{version}-venv"
    if not os.path.exists(os.path.join(sysconfig.get_paths()["include"], "Python.h")):
        yield f"Python {version} has no headers: apt install python{version}-dev"
    if not shutil.which(os.environ.get("CXX", "g++").split()[0]):
        yield "there is no C++ compiler: apt install g++"
    free = shutil.disk_usage(folder).free >> 20
    if free < MIB_NEEDED:
        yield f"{free} MiB are free in {folder}, {MIB_NEEDED} MiB are needed"


def steps(python, constraints):
    """Yield (what, command) of each step after the environment exists."""
    pip = [python, "-m", "pip", "install", "--quiet"]
    read = "from pip._vendor import tomli; print(*tomli.load(open('pyproject.toml', 'rb'))['build-system']['requires'])"
    required = subprocess.check_output([python, "-c", read], universal_newlines=True).split()
    if constraints:
        required = [each for each in required if not each.startswith("ros-")] + ["-r", constraints]
    yield "pip", [*pip, "--upgrade", "pip"]
    yield "build tools", [*pip, *required]
    yield "ROS 2, libraries and the ROS interfaces", [*pip, "--no-build-isolation", "-e", f".[{EXTRAS}]"]
    yield "check", [python, "-c", "from deltacharger.msg import TactileFrame"]


def cause(text):
    """Return one line for what a failed step printed."""
    for pattern, line in CAUSES:
        if re.search(pattern, text):
            return line
    errors = [line for line in text.splitlines() if line.startswith("ERROR") or "deltacharger:" in line]
    return errors[-1] if errors else (text.strip().splitlines() or ["it printed nothing"])[-1]


def build(folder, constraints):
    """Build the environment; exit with one line where a step fails."""
    python, log = os.path.join(folder, "bin", "python"), os.path.join(folder, "build.log")
    print(f"building {folder}, once: two to five minutes", flush=True)
    run("virtual environment", [sys.executable, "-m", "venv", folder], None)
    with open(log, "w"):
        pass
    for what, command in steps(python, constraints):
        run(what, command, log)


def run(what, command, log):
    """Run a step, print how long it took, and keep what it printed in `log`."""
    began = time.monotonic()
    step = subprocess.run(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=dict(os.environ, PYTHONWARNINGS="ignore"),
    )
    if log is not None:
        with open(log, "a") as file:
            file.write(step.stdout)
    if step.returncode:
        where = "" if log is None else f"; see {log}"
        sys.exit(f"cannot build: {what}: {cause(step.stdout)}{where}")
    print(f"  {what}: {time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    found = list(missing(os.getcwd()))
    if found:
        sys.exit("\n".join("cannot build: " + each for each in found))
    build(sys.argv[1], sys.argv[2] if len(sys.argv) > 2 else "")
