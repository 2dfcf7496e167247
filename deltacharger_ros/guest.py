# SPDX-License-Identifier: Apache-2.0
"""Programs beside a charger: a node of its own name that has no parameters and no log, served until it is closed."""

from __future__ import annotations

import uuid
from typing import TypeVar

from rclpy.context import Context
from rclpy.node import Node

from deltacharger_ros.executor import Spinner

Self = TypeVar("Self", bound="Guest")


class Guest:
    """Leaves the graph at the end of a `with` block.

    Args:
        name: what the node's name begins with.
        context: a running rclpy context.
        namespace: of the charger.

    Attributes:
        node: what a guest hears and says goes through it.
    """

    def __init__(self, name: str, context: Context, namespace: str) -> None:
        self.node = Node(
            f"{name}_{uuid.uuid4().hex[:8]}",
            context=context,
            namespace=namespace,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._spinner: Spinner | None = None
        self._open = True

    def serve(self) -> None:
        """Have the node served from now on."""
        self._spinner = Spinner(self.node)

    def close(self) -> None:
        """Leave the graph. Safe to call twice."""
        if not self._open:
            return
        self._open = False
        if self._spinner is not None:
            self._spinner.close()
        else:
            self.node.destroy_node()

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
