# SPDX-License-Identifier: Apache-2.0
"""A scene's nodes in one process, each with its own executor and thread, started and closed in a safe order."""

from __future__ import annotations

import contextlib
import sys
from typing import TYPE_CHECKING, Any

from rclpy.context import Context
from rclpy.parameter import Parameter

from deltacharger_bringup.scenes.node_table import NODES, load
from deltacharger_bringup.scenes.scene import Scene
from deltacharger_core.ros.executor import Spinner

if TYPE_CHECKING:
    from deltacharger_sim.charger.simulated_charger import SimulatedCharger


class Composition:
    """Runs a scene's nodes in this process, and its simulated charger if it has one.

    Commanding nodes start last and close first: docking_node opens the contactor and makes the arm safe while the
    others still serve it. The simulated charger closes last. If a part fails to start, the running parts are closed and
    the error is raised.

    Args:
        scene: what to start.
        context: a running rclpy context.
        namespace: of all nodes; '' = none.
        held: block docking_node's commands and let its goals wait, until `release`.

    Raises:
        StartupError: a node rejects its parameters.
        SceneError: the scene needs something that is not installed.
    """

    def __init__(self, scene: Scene, context: Context, namespace: str = "", held: bool = False) -> None:
        self.scene = scene
        self.nodes: dict[str, Spinner] = {}
        self.charger: SimulatedCharger | None = None
        self._context = context
        self._namespace = namespace
        self._held = held

    def start(self) -> Composition:
        """Start the simulated charger, then the nodes; no effect if they run."""
        if self.nodes or self.charger is not None:
            return self
        try:
            self._start()
        except BaseException:
            self.close()
            raise
        return self

    def close(self) -> None:
        """Close the nodes in reverse order of their start, then the simulated charger. Safe to call twice."""
        nodes, self.nodes = self.nodes, {}
        charger, self.charger = self.charger, None
        with contextlib.ExitStack() as stack:  # an error in one must not keep the others open
            if charger is not None:
                stack.callback(charger.stop)
            for spinner in nodes.values():
                stack.callback(spinner.close)

    def release(self) -> None:
        """Let docking_node command; only if it is held."""
        self.node("docking_node").release()

    def __enter__(self) -> Composition:
        return self.start()

    def __exit__(self, *exception: object) -> None:
        self.close()

    def node(self, name: str) -> Any:
        """Return the running node of an executable.

        Raises:
            KeyError: it is not running.
        """
        return self.nodes[name].node

    def ports(self) -> dict[str, str]:
        """Return the ports of the simulated charger by name; empty without one."""
        if self.charger is None:
            return {}
        return {"servo": self.charger.servo_port, "board": self.charger.board_port}

    def failed(self) -> list[str]:
        """Return the nodes whose executor has ended and the emulators that failed; empty if there are none."""
        broken = [name for name, spinner in self.nodes.items() if not spinner.is_alive()]
        if self.charger is not None:
            broken += [f"simulated charger ({error})" for error in self.charger.errors()]
        return broken

    def _start(self) -> None:
        if self.scene.simulation is not None:
            from deltacharger_sim.charger.simulated_charger import SimulatedCharger

            self.charger = SimulatedCharger(self.scene.simulation, namespace=self._namespace).start()
        ports = self.ports()
        for name in self.scene.start_order():
            node = load(NODES[name].path)(
                context=self._context,
                namespace=self._namespace or None,
                parameter_overrides=[
                    Parameter(key, value=value) for key, value in self.scene.node_parameters(name, ports).items()
                ],
                use_global_arguments=False,
                **({"held": True} if self._held and name == "docking_node" else {}),
            )
            self.nodes[name] = Spinner(node)


def load_nodes(scene: Scene) -> None:
    """Import the modules of the scene's nodes; errors are ignored here, and raised when the nodes start."""
    with contextlib.suppress(Exception):
        for name in scene.start_order():
            load(NODES[name].path)


def describe(composition: Composition) -> str:
    """Return a one-line description of the composition."""
    names = ", ".join(composition.nodes)
    if composition.charger is not None:
        kind = "simulated"
    else:
        kind = "on its own ports" if composition.scene.touches_hardware else "without ports"
    return f"scene '{composition.scene.name}' ({kind}): {names}; Python {sys.version_info[0]}.{sys.version_info[1]}"
