"""`SlidingModeController`: sliding mode with a boundary layer in (z, v), for a stated error of the model."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from eos_pin._arrays import Array, JointVector, TaskVector, Vector, checked, frozen_copy, number
from eos_pin.charts.atlas import Atlas
from eos_pin.control.base import Controller, ControlReport
from eos_pin.control.eos import EosController
from eos_pin.control.objectives import Track
from eos_pin.control.rivals.parts import jacobian_rate
from eos_pin.control.state import EosState
from eos_pin.errors import InputError
from eos_pin.robot.regressor import parameter_bounds, passive_regressor, passive_torque
from eos_pin.tasks.base import Task
from eos_pin.trajectories.base import Target, Trajectory


class Surface(NamedTuple):
    """Distance from the sliding surface and the boundary layer around it, in coordinates σ in which the mass is 1.

    Attributes:
        s: Velocity dw_r − dw of w = (z, v) that is lacking, (n,).
        sigma: The same as σ = Lᵀs, with HᵀMH = L Lᵀ, (n,) [√J].
        layer: Thickness φ of the boundary layer, (n,) [√J].
        force: Most force k that the switching term may take, (n,) [√J/s].
        bound: Change of the force L⁻¹HᵀF that model errors up to the stated one make, at most, (n,) [√J/s].
    """

    s: Vector
    sigma: Vector
    layer: Vector
    force: Vector
    bound: Vector


class SlidingModeController(EosController):
    """Sliding mode with a boundary layer in extended operational space, robust to a stated error of the model.

    With e = w_d − w, dw_r = dw_d + λ e, s = dw_r − dw, dq_r = H dw_r, HᵀMH = L Lᵀ and σ = Lᵀs,
    tau = M ddq_r + C dq_r + g + H⁻ᵀ L sat(β σ), each component cut at ±k, k = |L⁻¹HᵀY| Δθ + η, with the regressor Y of
    the first three terms and bounds Δθ of the inertial parameters' errors. As Ṁ − 2C is skew, the energy ½ sᵀHᵀM H s of
    the true robot falls while every component of σ is outside of the layer φ = k/β, whatever the error of the model
    within Δθ is. In the layer the law is smooth: PD control with kp = λ β, kd = λ + β and the mass matrix, as that of
    `EosController`. So with the same gains both leave the same errors there; what is gained is the bound, |σ| ≤ φ, and
    that the switching term never exceeds k. After Slotine and Li, *Applied nonlinear control*, 1991, Secs. 7.4 and 9.2;
    there in joints and with a diagonal in the place of L, by which light directions get a multiple of β where the
    coupling is strong.

    The bound holds for continuous control and without other disturbances: friction, a payload or delay need a larger
    `model_error`. Of rotations the rate of the error is taken for dz_d − dz, to the first order in the error. Where the
    task is singular or a chart ends the law ends.

    Args:
        task: The task.
        reference: Trajectory of the task.
        self_motion: Self-motion that is tracked; by default v is held where it is at the start. Its gains do not count.
        model_error: Largest relative error of each link's mass, of the coordinates of its centre and of its principal
            second moments.
        rate: Rate λ at which errors decay on the surface [1/s].
        bandwidth: Rate β at which s decays in the layer [1/s]; a fifth of the control rate at most.
        reaching: Deceleration η of σ that is left outside of the layer [√J/s].
        gravity: Whether the controller compensates gravity.
        atlas: Rule by which charts follow each other; by default that of `Atlas(task)`.

    Raises:
        InputError: A number is out of its range, or the self-motion has another law than a `Track`.
        RobotError: The robot lacks mass, or has joints that follow others.
    """

    _tells_time = False

    @checked
    def __init__(
        self,
        task: Task,
        reference: Trajectory,
        self_motion: Track | None = None,
        *,
        model_error: float = 0.2,
        rate: float = 10.0,
        bandwidth: float = 50.0,
        reaching: float = 0.5,
        gravity: bool = True,
        atlas: Atlas | None = None,
    ) -> None:
        self.rate = number(rate, "the rate", above=0.0)
        self.bandwidth = number(bandwidth, "the bandwidth", above=0.0)
        self.reaching = number(reaching, "the reaching deceleration", at_least=0.0)
        self.model_error = number(model_error, "the model error", at_least=0.0)
        super().__init__(
            task,
            reference,
            self_motion,
            kp=self.rate * self.bandwidth,
            kd=self.rate + self.bandwidth,
            gravity=gravity,
            atlas=atlas,
        )
        #: Gains 0, 1 and λ of the task.
        self._no_task, self._one, self._slow = (np.full(task.m, gain) for gain in (0.0, 1.0, self.rate))
        self._bounds = frozen_copy(parameter_bounds(self._model, self.model_error))
        passive_regressor(self._model, *4 * [np.zeros(task.robot.n)])

    def _accepted(self, name: str, value: Any) -> Any:
        if name in ("kp", "kd") and name in vars(self):
            raise InputError(f"{name} of sliding mode follows from its rate and bandwidth; make another controller")
        return super()._accepted(name, value)

    def describe(self) -> dict[str, Any]:
        return super().describe() | {name: getattr(self, name) for name in (
            "model_error", "rate", "bandwidth", "reaching"
        )}  # fmt: skip

    @checked
    def surface(self, t: float, q: JointVector, dq: JointVector, state: EosState) -> Surface:
        """Distance from the sliding surface, and the boundary layer, in a state."""
        return self._sliding(t, q, dq, self._current(state))[0]

    def torque(self, t: float, q: JointVector, dq: JointVector, state: EosState) -> JointVector:
        return self._sliding(t, q, dq, self._current(state))[1]

    def step(self, t: float, q: JointVector, dq: JointVector, state: EosState) -> tuple[JointVector, EosState]:
        return Controller._step(self, t, q, dq, self._current(state))

    def update(self, t: float, q: JointVector, dq: JointVector, state: EosState) -> EosState:
        # Nothing is carried over: where dv jumps, s jumps, and comes back as from any distance.
        chart = self.atlas.next(state.chart, state.chart._unwrap(q))
        return self._memory(chart, state.number + 1)

    def evaluate(
        self, t: float, q: JointVector, dq: JointVector, state: EosState, tau: JointVector | None = None
    ) -> ControlReport:
        return Controller._evaluate(self, t, q, dq, state, tau)

    def task_deficit(self, t: float, q: JointVector, dq: JointVector, state: Any) -> TaskVector:
        # Switching is not what a law asks of the task; nothing is known of what is given up.
        return np.full(self.task.m, np.nan)

    def _sliding(self, t: float, q: JointVector, dq: JointVector, state: EosState) -> tuple[Surface, JointVector]:
        task, model, chart = self.task, self._model, state.chart
        q = chart._unwrap(q)
        point = task._at(q, dq)
        m, J, rest, slow = task.m, point.J, self._no_task, self.rate
        z_d, dz_d, ddz_d = self.reference(t)
        v_d, dv_d, ddv_d = self.self_motion._target(t, chart.r)  # type: ignore[misc]
        dv = chart._dv(dq)
        # The task's own differences: of velocities, with the error at the rate λ, and of the reference.
        lacking = task._tracking_acceleration(point.z, point.dz, Target(z_d, dz_d, rest), self._slow, self._one)
        ddz_r = task._tracking_acceleration(point.z, point.dz, Target(z_d, dz_d, ddz_d), rest, self._slow)
        s = np.concatenate((lacking, dv_d - dv + slow * (v_d - chart._v(q))))
        A = np.vstack((J, chart.Wt))
        dq_r = dq + chart._acceleration(J, s[:m], s[m:])
        ddv_r = ddv_d + slow * (dv_d - dv)
        ddq_r = chart._acceleration(J, ddz_r - jacobian_rate(task, q, dq).dot(dq_r), ddv_r)
        H = np.linalg.inv(A)
        L = np.linalg.cholesky(H.T.dot(model._mass(q)).dot(H))
        Y = passive_regressor(model, q, dq, dq_r, ddq_r)
        bound = np.abs(np.linalg.solve(L, H.T.dot(Y))).dot(self._bounds)
        force, sigma = bound + self.reaching, L.T.dot(s)
        switched: Array = np.clip(self.bandwidth * sigma, -force, force)
        tau = passive_torque(model, q, dq, dq_r, ddq_r) + A.T.dot(L.dot(switched))
        return Surface(s, sigma, force / self.bandwidth, force, bound), tau
