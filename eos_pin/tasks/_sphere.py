"""Directions: points of the sphere S², their tangent bases, logarithm, and the law of a direction that is tracked.

The sphere has no frame that is smooth everywhere. The basis of a direction a is that of a fixed pole, carried to a
along the great circle between them: it depends on a alone, and is smooth but at the point opposite to the pole.
Velocities are coordinates in the basis of the direction that moves. What is compared between two directions is compared
in space, and what is solved has its error and its Jacobian in the basis of one direction, so that neither motions nor
charts depend on where the pole is.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, TaskVector, Vector, as_floats, vector
from eos_pin._kernels.flat import POLE
from eos_pin.errors import InputError

#: Least (sin θ)/θ in velocities across the great circle; it counts within 9° of the opposite direction only.
_LEAST = 0.05

Basis = Float[np.ndarray, "2 3"]


def basis(a: Float[np.ndarray, " 3"]) -> Basis:
    """Orthonormal basis of the plane normal to a direction, as rows; with the direction it is right-handed."""
    x, y, z = a.dot(POLE).tolist()
    c = _share(x, y, z)
    return np.array([[1.0 - c * x * x, -c * x * y, -x], [-c * x * y, 1.0 - c * y * y, -y]]).dot(POLE.T)


def bending(a: Vector, dz: TaskVector) -> TaskVector:
    """Rate at which the coordinates of a velocity change because the basis turns as its direction moves.

    Args:
        a: The direction.
        dz: Its velocity in its own basis [rad/s].
    """
    x, y, z = a.dot(POLE).tolist()
    da = dz.dot(basis(a)).dot(POLE)
    rate = (x * float(da[1]) - y * float(da[0])) * _share(x, y, z)
    return np.array([-rate * dz[1], rate * dz[0]])


def _share(x: float, y: float, z: float) -> float:
    """1 / (1 + z) of a unit vector, exact near z = −1; there any basis is as good, and 0 gives one."""
    square = x * x + y * y
    return 1.0 / (1.0 + z) if z > 0.0 else (1.0 - z) / square if square > 0.0 else 0.0


def bases(a: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "K 2 3"]:
    """`basis` of several directions."""
    along = a @ POLE
    share = np.array([_share(*each) for each in along.tolist()]).reshape(-1, 1)
    return POLE.T[None, :2] - (share * along[:, :2])[:, :, None] * (a + POLE[:, 2])[:, None]


class Arc(NamedTuple):
    """Great circle from one direction to another.

    Attributes:
        angle: Its length [rad].
        along: Unit vector along it at its start, in the basis there; the first of the basis where angle is 0 or π.
    """

    angle: float
    along: Vector


def arc(a1: Vector, E0: Basis, a0: Vector) -> Arc:
    """Shortest great circle from a0, with the basis E0, to a1."""
    t = E0.dot(a1)
    sine = math.sqrt(t.dot(t))
    along = t / sine if sine > 0.0 else np.array([1.0, 0.0])
    return Arc(math.atan2(sine, float(a0.dot(a1))), along)


def log(a1: Vector, a0: Vector) -> TaskVector:
    """Logarithm on the sphere: the step from a0 to a1 in the basis of a0."""
    angle, along = arc(a1, basis(a0), a0)
    return angle * along


def exp(a: Vector, delta: TaskVector) -> Vector:
    """Direction that a step from a leads to."""
    angle = math.sqrt(delta.dot(delta))
    ahead = math.cos(angle) * a + _sinc(angle) * delta.dot(basis(a))
    return ahead / math.sqrt(ahead.dot(ahead))


def local_rate(delta: TaskVector, dz: TaskVector, a_bar: Vector) -> TaskVector:
    """Rate of `delta` where the direction exp(a_bar, delta) moves with dz."""
    angle = math.sqrt(delta.dot(delta))
    along = delta / angle if angle > 0.0 else np.array([1.0, 0.0])
    across = np.array([-along[1], along[0]])
    E = basis(a_bar)
    da = dz.dot(basis(exp(a_bar, delta)))
    forward = math.cos(angle) * along.dot(E) - math.sin(angle) * a_bar
    return da.dot(forward) * along + da.dot(across.dot(E)) / _sinc(angle) * across


def tracking_acceleration(
    a: Vector, dz: TaskVector, target: tuple[Vector, TaskVector, TaskVector], kp: Any, kd: Any
) -> TaskVector:
    """Acceleration with which the error of a direction obeys ε̈ + kd ε̇ + kp ε = 0.

    ε is the logarithm of a at the target's direction a_d, in a frame F that goes with a_d and does not roll about it:
    a = F s(ε), s = ((sin θ / θ) ε, cos θ), θ = |ε|. Two derivatives of it, solved for ä.

    Args:
        a: The direction.
        dz: Its velocity in its own basis [rad/s].
        target: Direction, velocity and acceleration of the target, in the basis of its own direction.
        kp: Gains on the error [1/s²].
        kd: Gains on its rate [1/s].
    """
    a_d, dz_d, ddz_d = target
    E, E_d = basis(a), basis(a_d)
    omega = _cross(a_d, dz_d.dot(E_d))
    alpha = _cross(a_d, (ddz_d - bending(a_d, dz_d)).dot(E_d))
    angle, r = arc(a, E_d, a_d)
    t = np.array([-r[1], r[0]])
    sine, cosine, ratio = math.sin(angle), math.cos(angle), _sinc(angle)
    # Velocity seen from F, along and across the great circle, and from it the rate of ε.
    seen = dz.dot(E) - _cross(omega, a)
    rate_r = float(seen.dot(cosine * r.dot(E_d) - sine * a_d))
    rate_t = float(seen.dot(t.dot(E_d))) / max(ratio, _LEAST)
    law = -kd * (rate_r * r + rate_t * t) - kp * (angle * r)
    law_r, law_t, bend = float(law.dot(r)), float(law.dot(t)), _bend(angle)
    s_r = cosine * law_r - sine * rate_r**2 + bend * rate_t**2
    s_t = ratio * law_t + 2.0 * bend * rate_r * rate_t
    s_3 = -sine * law_r - cosine * rate_r**2 - ratio * rate_t**2
    dda = (s_r * r + s_t * t).dot(E_d) + s_3 * a_d
    dda += 2.0 * _cross(omega, seen) + _cross(alpha, a) + _cross(omega, _cross(omega, a))
    return E.dot(dda) + bending(a, dz)


def coordinates(
    a: Float[np.ndarray, "K 3"], da: Float[np.ndarray, "K 3"], dda: Float[np.ndarray, "K 3"]
) -> tuple[Array, Array]:
    """Velocities and accelerations of moving directions in their own bases, from their derivatives in space."""
    (t, _), (dt, rate), (ddt, bend) = (np.hsplit(each @ POLE, [2]) for each in (a, da, dda))
    c = np.array([_share(*each) for each in (a @ POLE).tolist()])[:, None]
    # The basis is e = p − (p·a) c (a + pole) for p normal to the pole, so that e·ȧ = p·ȧ − (p·a) s with s = c pole·ȧ.
    s = c * rate
    return dt - t * s, ddt - dt * s - t * (c * bend - s * s)


def direction(value: Any, name: str) -> Vector:
    """Unit vector from three numbers, scaled to length 1.

    Raises:
        InputError: Not three numbers, or all zero.
    """
    a = vector(as_floats(value, name).ravel(), 3, name)
    length = float(np.linalg.norm(a))
    if not 1e-9 < length < math.inf:
        raise InputError(f"{name} must be a direction, three numbers that are not all zero; got {a.tolist()}")
    return a if abs(length - 1.0) < 1e-15 else a / length


def _cross(a: Vector, b: Vector) -> Vector:
    """Product a × b of two single vectors, in a fifth of the time that NumPy takes."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def _sinc(x: float) -> float:
    return math.sin(x) / x if abs(x) > 1e-8 else 1.0


def _bend(x: float) -> float:
    """(x cos x − sin x) / x²."""
    return (x * math.cos(x) - math.sin(x)) / (x * x) if abs(x) > 1e-3 else -x / 3.0 * (1.0 - 0.1 * x * x)
