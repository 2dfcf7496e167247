# SPDX-License-Identifier: Apache-2.0
"""Helpers to create and call ROS nodes in tests; `spin` in chargers.py serves them."""

import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
from rclpy.parameter import Parameter

from .waiting import DEADLINE


def options(context: Any, namespace: str = "", **parameters: Any) -> dict[str, Any]:
    """Return constructor arguments of a node, isolated from pytest's command line."""
    overrides = [Parameter(name, value=value) for name, value in parameters.items()]
    return {
        "context": context,
        "namespace": namespace,
        "use_global_arguments": False,
        "parameter_overrides": overrides,
    }


def call(client: Any, request: Any) -> Any:
    """Call a service and return its answer."""
    return answer(client.call_async(request))


def answer(future: Any) -> Any:
    """Wait for a future and return its result."""
    came = threading.Event()
    future.add_done_callback(lambda _: came.set())
    assert came.wait(DEADLINE), f"waited {DEADLINE:g} s for an answer"
    return future.result()


def numbers(message: Any) -> Iterator[float]:
    """Yield every floating-point number of a message and its nested messages."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            yield from numbers(value)
        elif kind.startswith(("float", "double")):
            yield from np.atleast_1d(value)
