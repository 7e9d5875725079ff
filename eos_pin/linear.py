"""Linear algebra that charts need and no library has in this form."""

from __future__ import annotations

from itertools import count
from operator import ne

import numpy as np
import scipy.linalg
from jaxtyping import Float

from eos_pin.arrays import Array, Jacobian, JointVector, Matrix, Vector
from eos_pin.errors import SingularError

#: G' counts as rank deficient where its smallest singular value falls below this fraction of the largest.
RANK_TOLERANCE = 1e-7
#: Below this singular value a direction fades out of a control law: 0.05 of the robot's reach per radian.
FADING = 0.05
#: Rate at which motion in a direction that fades out is braked [1/s].
BRAKING = 20.0


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


def is_odd(LU: Array, pivots: Array) -> bool:
    """Whether the determinant of a factored matrix is negative."""
    negative, swapped = map((0.0).__gt__, LU.diagonal().tolist()), map(ne, pivots.tolist(), count())
    return (sum(negative) + sum(swapped)) % 2 == 1


def fading_solve(A: Matrix, b: Vector, dq: JointVector) -> JointVector:
    """Solution of A x = b that stays bounded and continuous where A loses rank, for accelerations of joints that move.

    A singular value s below ε = FADING counts as s/ε² instead of 1/s, so that its direction fades out, and braking
    −BRAKING dq takes its place by the part 1 − s²/ε². Above ε this is the plain solution.

    Args:
        A: Square matrix, its rows weighted so that singular values compare.
        b: Right side, weighted likewise.
        dq: Joint velocities.
    """
    X, s, Yt = np.linalg.svd(A)
    kept = np.minimum((s / FADING) ** 2, 1.0)
    gain = np.minimum(s / FADING**2, 1.0 / np.maximum(s, FADING))
    return Yt.T @ (gain * (X.T @ b) - (1.0 - kept) * BRAKING * (Yt @ dq))
