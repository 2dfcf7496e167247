# SPDX-License-Identifier: Apache-2.0
"""The nodes of a scene in one process, each with its own executor and thread, started and ended in a safe order."""

from __future__ import annotations

import contextlib
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rclpy.context import Context
from rclpy.parameter import Parameter

from deltacharger_ros.executor import Spinner
from deltacharger_scenes.node_table import NODES, load
from deltacharger_scenes.scene import Scene

if TYPE_CHECKING:
    from deltacharger_sim.charger.simulated_charger import SimulatedCharger


@dataclass(frozen=True)
class Running:
    """A node of the composition by its executable's name."""

    name: str
    spinner: Spinner

    @property
    def node(self) -> Any:
        """The node itself."""
        return self.spinner.node


class Composition:
    """Run a scene's nodes in this process, and its simulated charger where it has one.

    They start so that whoever commands comes last, and close in the reverse order: docking_node first (it opens the
    contactor and makes the arm safe while the others still serve it), the simulated charger at the very end. When one
    part fails to start, those that run are closed and the error goes on.

    Args:
        scene: what to start.
        context: a running rclpy context.
        namespace: for every node; empty for none.
        held: let docking_node command nothing, and its goals wait, until `release`.

    Raises:
        StartupError: a node refuses its parameters.
        SceneError: the scene asks for something that this installation lacks.
    """

    def __init__(self, scene: Scene, context: Context, namespace: str = "", held: bool = False) -> None:
        self.scene = scene
        self.nodes: list[Running] = []
        self.charger: SimulatedCharger | None = None
        self._context = context
        self._namespace = namespace
        self._held = held

    def start(self) -> Composition:
        """Start the simulated charger, then the nodes; does nothing where they run."""
        if self.nodes or self.charger is not None:
            return self
        try:
            self._start()
        except BaseException:
            self.close()
            raise
        return self

    def close(self) -> None:
        """Close the nodes in the reverse order of their start, then the simulated charger. Safe to call twice."""
        nodes, self.nodes = self.nodes, []
        charger, self.charger = self.charger, None
        with contextlib.ExitStack() as stack:  # one that fails to close never keeps the others open
            if charger is not None:
                stack.callback(charger.stop)
            for running in nodes:
                stack.callback(running.spinner.close)

    def release(self) -> None:
        """Let docking_node work; only where it is held."""
        self.node("docking_node").release()

    def __enter__(self) -> Composition:
        return self.start()

    def __exit__(self, *exception: object) -> None:
        self.close()

    def node(self, name: str) -> Any:
        """Return the running node that the executable `name` would run.

        Raises:
            KeyError: the scene has none.
        """
        for running in self.nodes:
            if running.name == name:
                return running.node
        raise KeyError(f"{name} is not running; running: {', '.join(r.name for r in self.nodes) or 'nothing'}")

    def ports(self) -> dict[str, str]:
        """Return the ports of the simulated charger by name; empty where there is none."""
        if self.charger is None:
            return {}
        return {"servo": self.charger.servo_port, "board": self.charger.board_port}

    def failed(self) -> list[str]:
        """Return the nodes whose executor has ended and the emulators that broke; empty when all is well."""
        broken = [running.name for running in self.nodes if not running.spinner.is_alive()]
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
            self.nodes.append(Running(name, Spinner(node)))


def load_nodes(scene: Scene) -> None:
    """Import what the scene's nodes are made of; who starts them imports it again, and hears why it fails."""
    with contextlib.suppress(Exception):
        for name in scene.start_order():
            load(NODES[name].path)


def describe(composition: Composition) -> str:
    """Return one line that says what runs."""
    names = ", ".join(running.name for running in composition.nodes)
    if composition.charger is not None:
        kind = "simulated"
    else:
        kind = "on its own ports" if composition.scene.touches_hardware else "without ports"
    return f"scene '{composition.scene.name}' ({kind}): {names}; Python {sys.version_info[0]}.{sys.version_info[1]}"
