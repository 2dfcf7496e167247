# SPDX-License-Identifier: Apache-2.0
"""Isolates processes that run tests in parallel (`pytest -n 2`): separate nodes, locks and sockets."""

import atexit
import ctypes
import os
import shutil
import tempfile
from pathlib import Path

from deltacharger_core.environment import LARGEST_DOMAIN

DOMAIN = "88"
"""Default ROS domain of the tests."""
APART = 10
"""Domains between two workers; some tests also use the next ones."""
_DROP_FOR_CHILDREN, _MAY_HAVE_PRIORITY = 24, 23  # PR_CAPBSET_DROP and CAP_SYS_NICE of Linux


def stay_apart() -> None:
    """Give a worker its own ROS domain, folders and core; call before the first import of rclpy and numpy."""
    os.environ.setdefault("ROS_DOMAIN_ID", DOMAIN)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # threads that spin for each other starve other processes
    # As on a laptop: nodes with real-time priority would starve the hardware that the tests of other workers emulate.
    ctypes.CDLL(None).prctl(_DROP_FOR_CHILDREN, _MAY_HAVE_PRIORITY, 0, 0, 0)
    worker = os.environ.pop("PYTEST_XDIST_WORKER", None)  # not for a pytest started by a test
    if worker is None:
        return
    number = int(os.environ["ROS_DOMAIN_ID"]) + APART * (1 + int(worker.removeprefix("gw")))
    folder = tempfile.mkdtemp(prefix=f"deltacharger-{worker}-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ["ROS_DOMAIN_ID"] = str(number % (LARGEST_DOMAIN + 1))
    os.environ["XDG_RUNTIME_DIR"] = folder
    os.environ["ROS_LOG_DIR"] = str(Path(os.environ.get("ROS_LOG_DIR", folder), worker))
