# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled twins of smaller parts: limits, the watch of a loop, curves, poses, Newton's method, the rate of the state."""

cimport numpy as cnp
from libc.math cimport INFINITY, cos, fabs, isfinite, sin, sqrt
from scipy.linalg.cython_lapack cimport dgetrf, dgetri, dposv

from eos_pin._kernels._common cimport as_plain, as_table, data, dot, empty, entry, named, plain, table

import numpy as np
from pinocchio import log3

from eos_pin._kernels import dispatch

cnp.import_array()

cdef int DONE = dispatch.DONE, UNDECIDED = dispatch.UNDECIDED, NO_ANSWER = dispatch.NO_ANSWER


cdef class Limits:
    """`plain_parts.Limits`.

    Args:
        period: Control period.
        rate, ends, fastest, braking, acceleration: As for `plain_parts.Viability`.
        torque: Largest torques, (n,).
        clear: How much more each joint may be accelerated where limits are not looked at more closely.
        model: Robot whose dynamics count.
        smallest: `SmallestChange`.
    """

    cdef Py_ssize_t n
    cdef double half, rate, clear
    cdef double *ends
    cdef double *fastest
    cdef double *braking
    cdef double *acceleration
    cdef double *torque
    cdef double *least
    cdef double *most
    cdef double *factor
    cdef object model, smallest
    cdef tuple made_from, kept

    def __init__(self, period, rate, ends, fastest, braking, acceleration, torque, clear, model, smallest):
        self.made_from = period, rate, ends, fastest, braking, acceleration, torque, clear, model, smallest
        self.half, self.rate, self.clear, self.model, self.smallest = 0.5 * period, rate, clear, model, smallest
        self.n = n = len(torque)
        vectors = tuple(np.array(x, dtype=float) for x in (ends, fastest, braking, acceleration, torque))
        self.kept = *vectors, np.empty(n), np.empty(n), np.empty(n * n)
        self.ends, self.fastest, self.braking, self.acceleration = (
            data(vectors[0]), data(vectors[1]), data(vectors[2]), data(vectors[3])
        )
        self.torque, self.least, self.most, self.factor = (
            data(vectors[4]), data(self.kept[5]), data(self.kept[6]), data(self.kept[7])
        )

    def __reduce__(self):
        return type(self), self.made_from

    cdef double bound(self, Py_ssize_t i, double q, double dq) noexcept:
        """Largest acceleration of a joint towards a limit."""
        cdef double room = self.ends[i] - q, b = self.braking[i], speed = self.rate * dq
        cdef double root = sqrt(2.0 * self.rate * self.rate * b * max(room, 0.0) + b * b)
        cdef double beyond = self.rate * self.rate * min(room, 0.0), slower = 1.0 - beyond / self.fastest[i]
        cdef double most = root - b + beyond / slower - b / root * speed / (slower * slower)
        return min(max(min(most, self.fastest[i]) - speed, -self.acceleration[i]), self.acceleration[i])

    cdef double kept_to(self, Py_ssize_t i, double ddq) noexcept:
        return min(max(ddq, self.least[i]), self.most[i])

    def __call__(self, joints, velocities, accelerations, J):
        cdef Py_ssize_t n = self.n, i, j
        cdef double up, down, part = 0.0, room = INFINITY, half = self.half, quarter = 0.5 * self.half * self.half
        cdef cnp.ndarray q = as_plain(joints, n), dq = as_plain(velocities, n), ddq = as_plain(accelerations, n)
        cdef cnp.ndarray tau = self.model._inverse_dynamics(q, dq, ddq)
        cdef cnp.ndarray change = empty(n)
        for i in range(n):
            up, down = self.bound(i, data(q)[i], data(dq)[i]), self.bound(n + i, -data(q)[i], -data(dq)[i])
            room = min(room, min(up - data(ddq)[i], down + data(ddq)[i]))
            part += (data(tau)[i] / self.torque[i]) * (data(tau)[i] / self.torque[i])
            self.most[i], self.least[i] = up, min(-down, up)
            data(change)[i] = 0.0
        if part < 1.0 and room > self.clear:
            return tau, change
        cdef cnp.ndarray middle = empty(n), speed = empty(n), below = empty(2 * n), above = empty(2 * n)
        cdef cnp.ndarray shift = empty(n), mean, more, M
        for i in range(n):
            data(shift)[i] = self.kept_to(i, data(ddq)[i])
            data(speed)[i] = data(dq)[i] + half * data(shift)[i]
            data(middle)[i] = data(q)[i] + half * data(dq)[i] + quarter * data(shift)[i]
        M = self.model._mass(middle)
        mean = self.accelerations(M, self.model._bias(middle, speed), tau)
        if self.within(mean, tau, below, above):
            return tau, change
        for i in range(n):
            data(shift)[i] -= self.kept_to(i, data(mean)[i])
        change = self.smallest(J, M, below, above)
        part = 0.0
        for i in range(n):
            data(mean)[i] += data(change)[i]
            data(speed)[i] = data(dq)[i] + half * (data(mean)[i] + data(shift)[i])
            data(middle)[i] = data(q)[i] + half * data(dq)[i] + quarter * (data(mean)[i] + data(shift)[i])
        tau = self.model._inverse_dynamics(middle, speed, mean)
        for i in range(n):
            part = max(part, fabs(data(tau)[i]) / self.torque[i])
        if part > 1.0:
            self.within(mean, tau, below, above)
            for i in range(n):
                data(below)[i], data(above)[i] = min(data(below)[i], 0.0), max(data(above)[i], 0.0)
            M = self.model._mass(middle)
            more = self.smallest(J, M, below, above)
            for i in range(n):
                data(change)[i] += data(more)[i]
                for j in range(n):
                    data(tau)[i] += entry(M, i, j) * data(more)[j]
                data(tau)[i] = min(max(data(tau)[i], -self.torque[i]), self.torque[i])
        return tau, change

    cdef cnp.ndarray accelerations(self, cnp.ndarray M, cnp.ndarray bias, cnp.ndarray tau):
        """M⁻¹ (tau − bias)."""
        cdef int n = self.n, one = 1, info = 0
        cdef cnp.ndarray ddq = empty(n)
        cdef Py_ssize_t i, j
        for i in range(n):
            data(ddq)[i] = data(tau)[i] - data(bias)[i]
            for j in range(n):
                self.factor[i * n + j] = entry(M, i, j)
        dposv("U", &n, &one, self.factor, &n, data(ddq), &n, &info)
        return ddq

    cdef bint within(self, cnp.ndarray mean, cnp.ndarray tau, cnp.ndarray below, cnp.ndarray above) noexcept:
        """Whether accelerations and torques are within their limits; how far off these are, below and above."""
        cdef Py_ssize_t n = self.n, i
        cdef bint inside = True
        for i in range(n):
            data(below)[i], data(above)[i] = self.least[i] - data(mean)[i], self.most[i] - data(mean)[i]
            data(below)[n + i], data(above)[n + i] = -self.torque[i] - data(tau)[i], self.torque[i] - data(tau)[i]
        for i in range(2 * n):
            inside &= data(below)[i] <= 0.0 <= data(above)[i]
        return inside


cdef class ChangeProgram:
    """`plain_parts.ChangeProgram`, with the same arguments."""

    cdef object update, solve
    cdef tuple made_from, arguments
    cdef double *rows
    cdef double *upper
    cdef double *lower
    cdef double full_price
    cdef Py_ssize_t m, n

    def __init__(self, model, cnp.ndarray rows, cnp.ndarray upper, cnp.ndarray lower, cnp.ndarray kinds, full_price):
        self.made_from = model, rows, upper, lower, kinds, full_price
        # Neither H nor f changes.
        self.update, self.solve, self.arguments = model.update, model.solve, (None, None, rows, upper, lower, kinds)
        self.rows, self.upper, self.lower, self.full_price = data(rows), data(upper), data(lower), full_price
        self.n, self.m = rows.shape[1], rows.shape[0] - rows.shape[1]

    def __reduce__(self):
        return type(self), self.made_from

    def __call__(self, jacobian, mass, least, most):
        cdef Py_ssize_t n = self.n, m = self.m, i, j
        cdef cnp.ndarray J = as_table(jacobian, m, n), M = as_table(mass, n, n)
        cdef cnp.ndarray lower = as_plain(least, 2 * n), upper = as_plain(most, 2 * n), change, paid
        cdef double size
        for i in range(n):
            for j in range(n):
                self.rows[i * n + j] = entry(M, i, j)
        for i in range(m):
            for j in range(n):
                self.rows[(n + i) * n + j] = entry(J, i, j)
        for i in range(2 * n):
            self.lower[i], self.upper[i] = data(lower)[i], data(upper)[i]
        self.update(*self.arguments)
        change, _, flag, info = self.solve()
        if not (flag > 0 and isfinite(dot(data(change), data(change), n))):
            return NO_ANSWER, change
        paid = info["lam"]
        size = dot(data(paid), data(paid), n)
        return DONE if size < self.full_price * self.full_price else UNDECIDED, change


cdef class StateMonitor:
    cdef double t, jump_squared
    cdef cnp.ndarray q
    cdef Py_ssize_t n

    def __init__(self, double t, q, double jump_squared):
        self.t, self.q, self.n, self.jump_squared = t, np.array(q, dtype=float), len(q), jump_squared

    def __reduce__(self):
        return type(self), (self.t, self.q, self.jump_squared)

    @property
    def last(self):
        return self.t, self.q.copy()

    @last.setter
    def last(self, state):
        self.t, self.q[:] = state

    def accepts(self, t, q, dq):
        cdef double moved = 0.0
        cdef double step, now
        cdef Py_ssize_t i
        if not (plain(q, self.n) and plain(dq, self.n)):
            return False
        try:
            now = t
        except (TypeError, OverflowError):
            return False
        for i in range(self.n):
            step = data(q)[i] - data(self.q)[i]
            moved += step * step
        if not (moved < self.jump_squared and self.t <= now < INFINITY and isfinite(dot(data(dq), data(dq), self.n))):
            return False
        self.t = now
        for i in range(self.n):
            data(self.q)[i] = data(q)[i]
        return True


def within_limits_fast(tau, cnp.ndarray per_limit):
    cdef Py_ssize_t n = cnp.PyArray_SIZE(per_limit), i
    cdef double total = 0.0
    cdef double part
    if not plain(tau, n):
        return False
    for i in range(n):
        part = data(tau)[i] * data(per_limit)[i]
        total += part * part
    return total <= 1.0


cdef class Curve:
    """`plain_parts.Curve`, with the same arguments."""

    cdef tuple made_from
    cdef cnp.ndarray frequencies, rows
    cdef object target
    cdef double phase
    cdef Py_ssize_t terms, first, second, width

    def __init__(self, phase, frequencies, rows, first, second, target):
        self.made_from = phase, frequencies, rows, first, second, target
        self.frequencies, self.rows = (np.array(given, dtype=float, order="C") for given in (frequencies, rows))
        self.phase, self.first, self.second, self.target = phase, first, second, target
        self.terms, self.width = len(frequencies), rows.shape[1]

    def __reduce__(self):
        return type(self), self.made_from

    def __call__(self, double t):
        cdef Py_ssize_t first = self.first, second = self.second, i, k
        cdef cnp.ndarray z = empty(first), dz = empty(second - first), ddz = empty(self.width - second)
        cdef double *row = data(self.rows) + 2 * self.terms * self.width
        cdef double *out
        cdef double s = 0.0, c = 1.0, angle
        t += self.phase
        for k in range(self.terms + 1):
            for i in range(self.width):
                out = data(z) + i if i < first else data(dz) + i - first if i < second else data(ddz) + i - second
                out[0] = row[i] if k == 0 else out[0] + s * row[i] + c * row[self.width + i]
            if k < self.terms:
                angle = data(self.frequencies)[k] * t
                s, c, row = sin(angle), cos(angle), data(self.rows) + 2 * k * self.width
        return named(self.target, (z, dz, ddz))


def flat_pose(cnp.ndarray array not None, double tolerance):
    cdef cnp.ndarray z = empty(12)
    cdef double *R = data(z) + 3
    cdef double off = 0.0, product
    cdef Py_ssize_t i, j
    if plain(array, 12):
        for i in range(12):
            data(z)[i] = data(array)[i]
    elif table(array, 4, 4) and entry(array, 3, 3) == 1.0 and not (
        entry(array, 3, 0) or entry(array, 3, 1) or entry(array, 3, 2)
    ):
        for i in range(3):
            data(z)[i] = entry(array, i, 3)
            for j in range(3):
                R[3 * i + j] = entry(array, i, j)
    else:
        return None
    for i in range(3):
        for j in range(3):
            product = R[i] * R[j] + R[3 + i] * R[3 + j] + R[6 + i] * R[6 + j]
            off = max(off, fabs(product - (i == j)))
    product = (
        R[0] * (R[4] * R[8] - R[5] * R[7]) - R[1] * (R[3] * R[8] - R[5] * R[6]) + R[2] * (R[3] * R[7] - R[4] * R[6])
    )
    return z if isfinite(dot(data(z), data(z), 12)) and off <= tolerance and product > 0.0 else None


def pose_difference(z1, z0):
    cdef cnp.npy_intp[2] shape = [3, 3]
    cdef cnp.ndarray R = cnp.PyArray_EMPTY(2, shape, cnp.NPY_DOUBLE, 0), delta = empty(6), turn
    cdef cnp.ndarray one = as_plain(z1, 12), other = as_plain(z0, 12)
    cdef Py_ssize_t i, j
    for i in range(3):
        data(delta)[i] = data(one)[i] - data(other)[i]
        for j in range(3):
            data(R)[3 * i + j] = dot(data(one) + 3 + 3 * i, data(other) + 3 + 3 * j, 3)
    turn = log3(R)
    for i in range(3):
        data(delta)[3 + i] = data(turn)[i]
    return delta


def largest(x):
    cdef double most = 0.0
    cdef Py_ssize_t i
    if not plain(x, len(x)):
        return float(np.abs(x).max(initial=0.0))
    for i in range(cnp.PyArray_DIM(x, 0)):
        # NaN stays.
        if not fabs(data(x)[i]) <= most:
            most = fabs(data(x)[i])
            if most != most:
                break
    return most


def on_chart_inverse(jacobian, cnp.ndarray U):
    cdef int n = cnp.PyArray_DIM(U, 0), m = cnp.PyArray_DIM(U, 1), room = 16 * m, info = 0
    cdef cnp.ndarray J = as_table(jacobian, m, n)
    cdef cnp.npy_intp[2] shape = [m, m]
    cdef cnp.ndarray B = cnp.PyArray_EMPTY(2, shape, cnp.NPY_DOUBLE, 1), work = empty(room)
    cdef cnp.ndarray swaps = cnp.PyArray_EMPTY(1, shape, cnp.NPY_INT, 0)
    cdef int *pivots = <int*>cnp.PyArray_DATA(swaps)
    cdef bint odd = False
    cdef Py_ssize_t i, j, k
    cdef double total
    for i in range(m):
        for j in range(m):
            total = 0.0
            for k in range(n):
                total += entry(J, i, k) * entry(U, k, j)
            data(B)[i + m * j] = total
    dgetrf(&m, &m, data(B), &m, pivots, &info)
    for i in range(m):
        odd ^= (pivots[i] != i + 1) ^ (data(B)[i + m * i] < 0.0)
    if info == 0:
        dgetri(&m, data(B), &m, pivots, data(work), &room, &info)
    return None if info or odd else B


def newton_step(base, cnp.ndarray U, u, B, error):
    cdef Py_ssize_t n = cnp.PyArray_DIM(U, 0), m = cnp.PyArray_DIM(U, 1), i, j
    cdef cnp.ndarray u_next = empty(m), q = empty(n)
    cdef cnp.ndarray start = as_plain(base, n), last = as_plain(u, m), inverse = as_table(B, m, m)
    cdef cnp.ndarray left = as_plain(error, m)
    for i in range(m):
        data(u_next)[i] = data(last)[i]
        for j in range(m):
            data(u_next)[i] += entry(inverse, i, j) * data(left)[j]
    for i in range(n):
        data(q)[i] = data(start)[i]
        for j in range(m):
            data(q)[i] -= entry(U, i, j) * data(u_next)[j]
    return u_next, q


def state_rate(cnp.ndarray dq, cnp.ndarray ddq, cnp.ndarray tau):
    cdef Py_ssize_t n = cnp.PyArray_SIZE(dq), i
    cdef cnp.ndarray dx = empty(2 * n + 1)
    if not (plain(dq, n) and plain(ddq, n) and plain(tau, n)):
        return np.concatenate((dq, ddq, [np.dot(tau, dq)]))
    for i in range(n):
        data(dx)[i], data(dx)[n + i] = data(dq)[i], data(ddq)[i]
    data(dx)[2 * n] = dot(data(tau), data(dq), n)
    return dx
