"""Linear algebra that charts need and no library has in this form."""

from __future__ import annotations

import math
from itertools import count
from operator import ne

import numpy as np
import scipy.linalg
from jaxtyping import Float

from eos_pin.arrays import Array, Jacobian, JointVector, Matrix, TaskVector
from eos_pin.errors import ChartError, SingularError

#: G' counts as rank deficient where its smallest singular value falls below this fraction of the largest.
RANK_TOLERANCE = 1e-7
#: Below this singular value a direction fades out of a control law: 0.05 of the robot's reach per radian.
FADING = 0.05
#: Joint speed beyond which directions fade out earlier: the length of dq [rad/s or m/s].
FAST = 4.0
#: Rate at which motion in a direction that fades out is braked [1/s]; more for joints faster than that, in proportion.
BRAKING = 20.0
#: Joint speed that no self-motion is meant to have: the length of dq. Beyond it self-motion is braked, at this rate for
#: each rad/s more; charts that follow each other faster than v is damped would make it grow without end [rad/s, 1].
RUNAWAY, RUNAWAY_BRAKING = 16.0, 10.0


def check_rank(J: Jacobian) -> None:
    """Refuse a Jacobian without full rank.

    Raises:
        SingularError: It has the rank and the singular values.
    """
    values = np.linalg.svd(J, compute_uv=False)
    rank = int((values > RANK_TOLERANCE * values[0]).sum())
    if rank < J.shape[0]:
        raise SingularError(
            f"the task is singular here: its Jacobian has rank {rank} of {J.shape[0]} (singular values "
            f"{', '.join(f'{s:.2g}' for s in values)}). Move away from this configuration, or drop the lost direction "
            "from the task",
            rank,
            values.tolist(),
        )


def null_space(J: Jacobian) -> Float[Array, "n r"]:
    """Orthonormal basis of the null space of J, the same on every machine: the sign of each column is fixed."""
    m = J.shape[0]
    V = scipy.linalg.qr(J.T)[0][:, m:]
    size = np.abs(V)
    # The last entry of about the largest size is positive; ties within rounding then cannot flip the sign.
    about = size >= 0.5 * size.max(axis=0, initial=0.0)
    last = V.shape[0] - 1 - about[::-1].argmax(axis=0)
    V[:, V[last, range(V.shape[1])] < 0.0] *= -1.0
    return V


def iterated_inverse(A: Matrix, B: Matrix, *, tol: float) -> Matrix:
    """Inverse of A by products only, from an approximation B; Eq. (21).

    Raises:
        ChartError: The iteration does not converge from B.
    """
    for _ in range(60):
        product = A @ B
        error = np.abs(product - np.eye(len(A))).max()
        if error <= tol:
            return B
        # Each iteration squares the residual, so one that is large will not come back.
        if not error < 1e6:
            break
        B = 2.0 * B - B @ product
    raise ChartError(f"the iteration for B diverges from this start (residual {error:.3g}); solve directly instead")


def is_odd(LU: Array, pivots: Array) -> bool:
    """Whether the determinant of a factored matrix is negative."""
    negative, swapped = map((0.0).__gt__, LU.diagonal().tolist()), map(ne, pivots.tolist(), count())
    return (sum(negative) + sum(swapped)) % 2 == 1


def haste(dq: JointVector) -> float:
    """Square of how many times faster than FAST the joints move; at least 1."""
    squared = dq.dot(dq)
    return 1.0 if squared < FAST**2 else squared / FAST**2


def fade(J: Jacobian, b: TaskVector, dq: JointVector) -> tuple[Jacobian, TaskVector]:
    """Y and c such that Y x = c says J x = b as far as it can without trouble, for accelerations x of joints that move.

    The rows of Y are orthonormal, so that x = Yᵀ c is the solution where J is square. A singular value s of J below ε
    counts as s/ε² instead of 1/s, so that its direction fades out, and braking −β dq takes its place by the part
    1 − s²/ε²; above ε nothing is changed. So x is bounded and continuous where J loses rank. ε and β are FADING and
    BRAKING, and grow in proportion to the speed of joints that are faster than FAST: Coriolis terms grow with the
    square of the speed, and as ε² does so too, what remains of them is bounded while the braking grows.

    Args:
        J: Jacobian, its rows weighted so that singular values compare.
        b: Right side, weighted likewise.
        dq: Joint velocities.
    """
    X, s, Y = np.linalg.svd(J, full_matrices=False)
    speed = math.sqrt(haste(dq))
    epsilon, beta = speed * FADING, speed * BRAKING
    kept = np.minimum((s / epsilon) ** 2, 1.0)
    gain = np.minimum(s / epsilon**2, 1.0 / np.maximum(s, epsilon))
    return Y, gain * (X.T @ b) - (1.0 - kept) * beta * (Y @ dq)
