# SPDX-License-Identifier: Apache-2.0
"""ROS nodes as tests make and ask them; `spin` in chargers.py serves them."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import rclpy.subscription
from rclpy.parameter import Parameter

from .waiting import DEADLINE

TELLS_PUBLISHERS = hasattr(rclpy.subscription, "MessageInfo")
"""Whether rclpy tells with a message who published it: Kilted's does."""


def options(context: Any, namespace: str = "", **parameters: Any) -> dict[str, Any]:
    """Return what a node is made with, so that it takes nothing from pytest's own command line."""
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
    """Return what a future comes to, as soon as it does."""
    came = threading.Event()
    future.add_done_callback(lambda _: came.set())
    assert came.wait(DEADLINE), f"waited {DEADLINE:g} s for an answer"
    return future.result()


def numbers(message: Any) -> Iterator[float]:
    """Yield every floating-point number of a message, those of messages in it too."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            yield from numbers(value)
        elif kind.startswith(("float", "double")):
            yield from np.atleast_1d(value)
