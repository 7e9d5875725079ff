# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled twins for control: the tracking law, the drive, limits, and the watch of a loop.

What each computes is written where its original is; here are the same sums without NumPy's price for a call. They give
the same to rounding, and return None where the original has to decide: near a singularity, and for arrays of another
kind than the package makes.
"""

cimport numpy as cnp
from libc.math cimport INFINITY, fabs, isfinite, sqrt
from scipy.linalg.cython_lapack cimport dgetrf, dgetri

from eos_pin._fast cimport data, dot, empty, entry, plain, table

import numpy as np

cnp.import_array()


def aligned(size):
    """Room for numbers that begins where vector units like it, so that sums have the same rounding every time."""
    room = np.zeros(size + 8)
    return room[(-room.ctypes.data % 64) // 8 :][:size]


cdef class Drive:
    """`Drive` on one chart, wherever nothing fades.

    Args:
        Vt: Transposed basis V of the null space at the base point, (r, n).
        Qt: Transposed orthonormal basis Q of the row space there, (m, n).
        most: Square of the size of U B from which directions may fade.
        fast: Joint speed from which they fade earlier.
    """

    cdef int n, m, room
    cdef double most, fast
    cdef double *Vt
    cdef double *Qt
    cdef double *J
    cdef double *F
    cdef double *A
    cdef double *x
    cdef double *work
    cdef int *pivots
    cdef tuple made_from, kept

    def __init__(self, Vt, Qt, double most, double fast):
        self.made_from = Vt, Qt, most, fast
        self.m, self.n = Qt.shape
        m, n, self.room, self.most, self.fast = self.m, self.n, 16 * self.m, most, fast
        self.kept = *(np.array(basis, dtype=float, order="C") for basis in (Vt, Qt)), *map(
            aligned, (m * n, n, m * m, m, self.room)
        ), np.empty(m, np.intc)
        self.Vt, self.Qt, self.J, self.F, self.A, self.x, self.work = (
            data(self.kept[0]), data(self.kept[1]), data(self.kept[2]), data(self.kept[3]), data(self.kept[4]),
            data(self.kept[5]), data(self.kept[6]),
        )
        self.pivots = <int*>cnp.PyArray_DATA(self.kept[7])

    def __reduce__(self):
        return type(self), self.made_from

    def __call__(self, cnp.ndarray J not None, F, dq):
        """Acceleration and bound of the margin; arguments as in `Drive` of `eos_pin.driving`."""
        if not (table(J, self.m, self.n) and plain(F, self.n) and plain(dq, self.n)):
            return None
        cdef Py_ssize_t i, j
        for i in range(self.m):
            for j in range(self.n):
                self.J[i * self.n + j] = entry(J, i, j)
        for j in range(self.n):
            self.F[j] = data(F)[j]
        return self.solve(data(dq))

    cdef solve(self, double* dq):
        """The same for what stands in J and F: ddq = V F_v + Q (JQ)⁻¹ (F_z − J V F_v), where U B = Q (JQ)⁻¹."""
        cdef int n = self.n, m = self.m, r = n - m, info = 0
        cdef double *A = self.A
        cdef double speed = dot(dq, dq, n) / (self.fast * self.fast), worn = 0.0, part
        cdef Py_ssize_t i, j, k
        for i in range(m):
            for k in range(m):
                A[i + m * k] = dot(self.J + i * n, self.Qt + k * n, n)
        dgetrf(&m, &m, A, &m, self.pivots, &info)
        if info == 0:
            dgetri(&m, A, &m, self.pivots, self.work, &self.room, &info)
        if info != 0 or not dot(A, A, m * m) * max(speed, 1.0) < self.most:
            return None
        cdef cnp.ndarray ddq = empty(n)
        cdef double *x = data(ddq)
        for j in range(n):
            x[j] = 0.0
        for k in range(r):
            for j in range(n):
                x[j] += self.Vt[k * n + j] * self.F[m + k]
        for i in range(m):
            self.F[i] -= dot(self.J + i * n, x, n)
        for k in range(m):
            part = 0.0
            for i in range(m):
                part += A[k + m * i] * self.F[i]
            for j in range(n):
                x[j] += self.Qt[k * n + j] * part
        # The squares of D = V − Q (JQ)⁻¹ J V, beyond those of V.
        for k in range(r):
            for i in range(m):
                self.x[i] = dot(self.J + i * n, self.Vt + k * n, n)
            for i in range(m):
                part = 0.0
                for j in range(m):
                    part += A[i + m * j] * self.x[j]
                worn += part * part
        return ddq, 1.0 / sqrt(1.0 + worn)


cdef class TrackingLaw(Drive):
    """`EosController.asked` for self-motion that is tracked, and `Chart.drive` of it; Eqs. (36), (45).

    Args:
        Vt, Qt, most, fast: As for `Drive`.
        kp, kd: Gains of the task, (m,).
        kp_v, kd_v: Gains of the self-motion, (r,).
        v: Where Vᵀ q should be, (r,).
        minus: Difference of two task points; None for a vector task.
    """

    cdef double *kp
    cdef double *kd
    cdef double *kp_v
    cdef double *kd_v
    cdef double *v
    cdef object minus

    def __init__(self, Vt, Qt, most, fast, kp, kd, kp_v, kd_v, v, minus):
        super().__init__(Vt, Qt, most, fast)
        self.made_from += kp, kd, kp_v, kd_v, v, minus
        self.minus = minus
        vectors = tuple(np.array(given, dtype=float) for given in (kp, kd, kp_v, kd_v, v))
        self.kept += vectors
        self.kp, self.kd, self.kp_v, self.kd_v, self.v = (
            data(vectors[0]), data(vectors[1]), data(vectors[2]), data(vectors[3]), data(vectors[4])
        )

    def __call__(
        self,
        cnp.ndarray z_d,
        cnp.ndarray z,
        cnp.ndarray dz_d,
        cnp.ndarray ddz_d,
        cnp.ndarray J not None,
        cnp.ndarray drift,
        cnp.ndarray q,
        cnp.ndarray dq,
        cnp.ndarray more,
    ):
        """Acceleration and bound of the margin, as `Drive` has them.

        Args:
            z_d, z: Where the task should be, and where it is.
            dz_d, ddz_d: What the task should do.
            J, drift: The task's Jacobian and its acceleration at ddq = 0.
            q, dq: State of the robot.
            more: What is asked of the self-motion beside this law, (r,), or None.
        """
        cdef Py_ssize_t n = self.n, m = self.m, r = n - m, i, j
        cdef double dz, e
        cdef cnp.ndarray error = z_d if self.minus is None else self.minus(z_d, z)
        if not (
            plain(error, m) and (self.minus is not None or plain(z, m)) and plain(dz_d, m) and plain(ddz_d, m) and table(J, m, n) and plain(drift, m)
            and plain(q, n) and plain(dq, n) and (more is None or plain(more, r))
        ):
            return None
        for i in range(m):
            dz = 0.0
            for j in range(n):
                self.J[i * n + j] = entry(J, i, j)
                dz += self.J[i * n + j] * data(dq)[j]
            e = data(error)[i] - data(z)[i] if self.minus is None else data(error)[i]
            self.F[i] = (
                self.kp[i] * e + self.kd[i] * (data(dz_d)[i] - dz) + (data(ddz_d)[i] - data(drift)[i])
            )
        for i in range(r):
            self.F[m + i] = (
                self.kp_v[i] * (self.v[i] - dot(self.Vt + i * n, data(q), n))
                - self.kd_v[i] * dot(self.Vt + i * n, data(dq), n)
            )
            if more is not None:
                self.F[m + i] += data(more)[i]
        return self.solve(data(dq))


cdef class Limits:
    """`LimitedEosController.readable`.

    Args:
        period: Control period.
        rate, ends, fastest, braking, acceleration: What `_Viability` makes bounds from.
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
    cdef object model, smallest
    cdef tuple made_from, kept

    def __init__(self, period, rate, ends, fastest, braking, acceleration, torque, clear, model, smallest):
        self.made_from = period, rate, ends, fastest, braking, acceleration, torque, clear, model, smallest
        self.half, self.rate, self.clear, self.model, self.smallest = 0.5 * period, rate, clear, model, smallest
        self.n = n = len(torque)
        vectors = tuple(np.array(x, dtype=float) for x in (ends, fastest, braking, acceleration, torque))
        self.kept = *vectors, np.empty(n), np.empty(n)
        self.ends, self.fastest, self.braking, self.acceleration = (
            data(vectors[0]), data(vectors[1]), data(vectors[2]), data(vectors[3])
        )
        self.torque, self.least, self.most = data(vectors[4]), data(self.kept[5]), data(self.kept[6])

    def __reduce__(self):
        return type(self), self.made_from

    cdef double bound(self, Py_ssize_t i, double q, double dq) noexcept:
        """Largest acceleration of a joint towards a limit."""
        cdef double room = self.ends[i] - q, b = self.braking[i], speed = self.rate * dq
        cdef double root = sqrt(2.0 * self.rate * self.rate * b * max(room, 0.0) + b * b)
        cdef double most = root - b + self.rate * self.rate * min(room, 0.0) - b / root * speed
        return min(max(min(most, self.fastest[i]) - speed, -self.acceleration[i]), self.acceleration[i])

    cdef double kept_to(self, Py_ssize_t i, double ddq) noexcept:
        return min(max(ddq, self.least[i]), self.most[i])

    def __call__(self, cnp.ndarray q, cnp.ndarray dq, cnp.ndarray ddq, cnp.ndarray J):
        cdef Py_ssize_t n = self.n, i, j
        cdef double up, down, part = 0.0, room = INFINITY, half = self.half, quarter = 0.5 * self.half * self.half
        if not (plain(q, n) and plain(dq, n) and plain(ddq, n)):
            return None
        cdef cnp.ndarray tau = self.model.inverse_dynamics(q, dq, ddq)
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
        mean = self.model.forward_dynamics(middle, speed, tau)
        if self.within(mean, tau, below, above):
            return tau, change
        for i in range(n):
            data(shift)[i] -= self.kept_to(i, data(mean)[i])
        change = self.smallest(J, self.model.mass(middle), below, above)
        part = 0.0
        for i in range(n):
            data(mean)[i] += data(change)[i]
            data(speed)[i] = data(dq)[i] + half * (data(mean)[i] + data(shift)[i])
            data(middle)[i] = data(q)[i] + half * data(dq)[i] + quarter * (data(mean)[i] + data(shift)[i])
        tau = self.model.inverse_dynamics(middle, speed, mean)
        for i in range(n):
            part = max(part, fabs(data(tau)[i]) / self.torque[i])
        if part > 1.0:
            self.within(mean, tau, below, above)
            M = self.model.mass(middle)
            more = self.smallest(J, M, below, above)
            for i in range(n):
                data(change)[i] += data(more)[i]
                for j in range(n):
                    data(tau)[i] += entry(M, i, j) * data(more)[j]
                data(tau)[i] = min(max(data(tau)[i], -self.torque[i]), self.torque[i])
        return tau, change

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


def usual(t, q, dq, double t_last, cnp.ndarray q_last, double jump_squared):
    cdef Py_ssize_t n = cnp.PyArray_DIM(q_last, 0), i
    cdef double moved = 0.0
    cdef double step, now
    if not (plain(q, n) and plain(dq, n)):
        return False
    try:
        now = t
    except (TypeError, OverflowError):
        return False
    for i in range(n):
        step = data(q)[i] - data(q_last)[i]
        moved += step * step
    return moved < jump_squared and t_last <= now < INFINITY and isfinite(dot(data(dq), data(dq), n))


def surely_within(tau, cnp.ndarray per_limit):
    cdef Py_ssize_t n = cnp.PyArray_SIZE(per_limit), i
    cdef double total = 0.0
    cdef double part
    if not plain(tau, n):
        return False
    for i in range(n):
        part = data(tau)[i] * data(per_limit)[i]
        total += part * part
    return total <= 1.0
