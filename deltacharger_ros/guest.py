# SPDX-License-Identifier: Apache-2.0
"""Node of a client program: unique name, no parameters, no log, served until it is closed."""

from __future__ import annotations

import threading
import time
import uuid
from collections.abc import Callable
from typing import Any, TypeVar

from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter

from deltacharger_ros.executor import Spinner

_POLL = 0.02  # s

Self = TypeVar("Self", bound="Guest")


class Guest:
    """Base of client programs; leaves the graph at the end of a `with` block.

    Args:
        name: beginning of the node's name.
        context: a running rclpy context.
        namespace: namespace of the charger.

    Attributes:
        node: the ROS node.
        waitables: action clients and servers of the node, destroyed after it was served.
    """

    def __init__(self, name: str, context: Context, namespace: str) -> None:
        self.node = Node(
            f"{name}_{uuid.uuid4().hex[:8]}",
            context=context,
            namespace=namespace,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],  # not needed
        )
        self._spinner: Spinner | None = None
        self.waitables: list[Any] = []
        self._open = True

    def serve(self) -> None:
        """Start to serve the node."""
        self._spinner = Spinner(self.node)

    def wait(
        self,
        condition: Callable[[], bool],
        timeout: float,
        check: Callable[[], None] | None = None,
        stop: threading.Event | None = None,
    ) -> bool:
        """Wait for `condition` at most `timeout` s or until `stop` is set; return whether it became true.

        Args:
            condition: polled.
            timeout: s.
            check: called at each poll; may raise.
            stop: ends the wait early when set.
        """
        end = time.monotonic() + timeout
        while not condition():
            if check is not None:
                check()
            if time.monotonic() > end or (stop is not None and stop.is_set()):
                return False
            time.sleep(_POLL)
        return True

    def close(self) -> None:
        """Leave the graph. Safe to call twice."""
        if not self._open:
            return
        self._open = False
        if self._spinner is not None:
            self._spinner.close(*self.waitables)
        else:
            self.node.destroy_node()

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
