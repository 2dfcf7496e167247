# SPDX-License-Identifier: Apache-2.0
"""Interface of a world to the model that moves its arm: the light model, or MuJoCo."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable

from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_sim import pads, touch
from deltacharger_sim.parameters import WorldParameters


class TargetFixed(RuntimeError):
    """The target of this model cannot move. Example: `World.move_target` of MuJoCo's world.

    Args:
        model: of the arm's motion.
    """

    def __init__(self, model: str) -> None:
        self.model = model
        super().__init__(
            f"the target cannot move while {model} moves the arm: use a World of the light model, or place the "
            "target by the parameters of a new world"
        )


_NONE: Vector = (0.0, 0.0, 0.0)
_UNTOUCHED = touch.Bars.flat(0.0)


class Motion(ABC):
    """State of the arm, and its step.

    Args:
        parameters: of the world.
        start: of the platform, m, charger_base.

    Attributes:
        position: of the platform, m, charger_base.
        velocity: m/s.
        angles: of the arms, rad.
        rates: rad/s.
        torques: of the motors, N·m, before gear friction.
        slack: by which play lets each encoder run ahead of its arm, rad.
        tilt: of the platform about x and y, rad; 0 without compliance.
        contact_force: total normal force on the electrodes, N.
        peak_force: largest one within the last step, N; in MuJoCo, at its end.
        magnet_force: pull of the magnets, N.
        gains: each servo's stiffness relative to the parameter, by its P gain; 1 = as servo_node sets it.
        brakes: each servo's damping likewise, by its D gain.
        rubs: Coulomb friction of each powered gear, N·m.
        imbalance: residual force of the last step's solution, N; small unless the step is long and friction slips.
        still: whether the last step moved nothing, so that the next one with equal inputs will not either.
    """

    def __init__(self, parameters: WorldParameters, start: Vector) -> None:
        self._parameters = parameters
        self._target_z = parameters.target.z if parameters.target.present else math.inf
        self.position = start
        self.velocity = self.angles = self.rates = self.torques = self.slack = _NONE
        self.gains: Vector = (1.0, 1.0, 1.0)
        self.brakes: Vector = (1.0, 1.0, 1.0)
        self.rubs: Vector = (parameters.servo.friction,) * 3
        self._shift = _NONE  # m, of the target from its parameters as the robots yield
        self._inputs: tuple[object, ...] = ()  # of the last step, in the model's form
        self.tilt = (0.0, 0.0)
        self._leans = touch.tilts(parameters)
        self._bars = _UNTOUCHED
        self.contact_force = self.peak_force = self.magnet_force = self.imbalance = 0.0
        self.still = False

    def set_gains(self, gains: Vector, brakes: Vector) -> None:
        """Set each servo's stiffness and damping, as shares of the parameters."""
        self.gains, self.brakes = gains, brakes
        self._inputs = ()

    def set_friction(self, rubs: Vector) -> None:
        """Set the Coulomb friction of each powered gear, N·m."""
        self.rubs = rubs
        self._inputs = ()

    def move_along(self, dz: float) -> None:
        """Move the target by `dz` m along z at once."""
        self._target_z += dz
        self._inputs, self.still = (), False

    @property
    def gap(self) -> float:
        """Distance between the contact faces (m); negative = springs compressed, inf = no target."""
        return self._target_z + self._shift[2] - self.position[2]

    @property
    def target_shift(self) -> Vector:
        """Displacement of the target from its parameters as the robots yield, m."""
        return self._shift

    @property
    def lean(self) -> pads.Lean | None:
        """Lean of the platform against the target; None if the platform is rigid and the target does not lean."""
        if not self._leans:
            return None
        (alpha, beta), target = self.tilt, self._parameters.target
        return pads.Lean((alpha - target.tilt_x, beta - target.tilt_y), (-target.tilt_x, -target.tilt_y))

    @property
    def bars(self) -> touch.Bars:
        """Forces on the bars."""
        if not self._leans and self._bars.upper != 0.5 * self.contact_force:
            self._bars = touch.Bars.flat(self.contact_force)
        return self._bars

    @property
    def onset(self) -> float:
        """Gap at which the faces first touch, m; 0 if nothing leans."""
        return 0.0

    @abstractmethod
    def step(
        self, dt: float, enabled: tuple[bool, bool, bool], reference: Vector, limit: Vector, x: float, y: float
    ) -> None:
        """Advance by `dt` s.

        Args:
            dt: s.
            enabled: whether each servo's torque is on.
            reference: goal angle of each servo, rad.
            limit: current bound of each servo, A.
            x: centre of the target's terminal in end_effector, m; a lateral offset weakens the magnets.
            y: along y, m.
        """

    def carry(self, dx: float, dy: float) -> None:
        """Let the target move by (dx, dy), m, before the next step; in contact, friction acts.

        Raises:
            TargetFixed: this model's target cannot move.
        """
        raise TargetFixed(type(self).__name__)


MakeMotion = Callable[[WorldParameters, DeltaGeometry, Vector], Motion]
"""Creates the motion of an arm that starts at a point (m)."""
