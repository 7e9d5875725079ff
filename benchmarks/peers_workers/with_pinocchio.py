"""Pinocchio alone: the calls that any control step contains, and its own example of inverse kinematics."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin
from serve import Call, Problem, iterate, serve

AXES = pin.LOCAL_WORLD_ALIGNED
#: Length of vectors whose product takes about as long as a control step.
PRODUCT = 56_000


def build(problem: Problem) -> Mapping[str, Call]:
    model = pin.buildModelFromUrdf(problem.urdf)
    data, frame, n = model.createData(), model.getFrameId(problem.frame), model.nv
    rest, turn = np.zeros(n), pin.exp3(np.full(3, 0.1))

    def bare(state: np.ndarray) -> np.ndarray:
        """Kinematics, Jacobian, drift and placement of the frame, of a pose the error in rotation; inverse dynamics."""
        q, dq = state[:n], state[n:]
        pin.forwardKinematics(model, data, q, dq, rest)
        pin.computeJointJacobians(model, data)
        pin.getFrameJacobian(model, data, frame, AXES)
        pin.getFrameClassicalAcceleration(model, data, frame, AXES)
        pin.updateFramePlacement(model, data, frame)
        if problem.whole:
            pin.log3(turn)
        return pin.rnea(model, data, q, dq, rest)

    def clik(damping: float) -> Call:
        """Closed-loop inverse kinematics as in Pinocchio's examples, with a step of one."""

        def solve(given: np.ndarray) -> np.ndarray:
            q, target = problem.split(given)
            wanted = pin.SE3(target)
            J, error = np.empty(0), np.empty(0)

            def left() -> np.ndarray:
                nonlocal J, error
                pin.forwardKinematics(model, data, q)
                placement = pin.updateFramePlacement(model, data, frame)
                if problem.whole:
                    between = placement.actInv(wanted)
                    error = pin.log6(between).vector
                    J = pin.Jlog6(between.inverse()) @ pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
                else:
                    error = wanted.translation - placement.translation
                    J = pin.computeFrameJacobian(model, data, q, frame, AXES)[:3]
                return error

            def improve() -> None:
                nonlocal q
                if damping:
                    step = J.T @ np.linalg.solve(J @ J.T + damping * np.eye(problem.m), error)
                else:
                    step = np.linalg.pinv(J) @ error
                q = pin.integrate(model, q, step)

            iterate(left, improve, problem)
            return q

        return solve

    numbers = np.ones(PRODUCT)

    def busy(state: np.ndarray) -> np.ndarray:
        """No step at all, but as long: what interrupts a step interrupts this."""
        numbers.dot(numbers)
        return state[:n]

    return {"bare:": bare, "along:busy": busy, "inverse:pseudoinverse": clik(0.0), "inverse:damped": clik(1e-12)}


if __name__ == "__main__":
    serve(build)
