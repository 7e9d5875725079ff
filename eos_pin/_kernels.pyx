# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled twins of formulas that run in every control step and in every solve of inverse kinematics.

What each computes is written where its original is; here are the same sums without NumPy's price for a call. They give
the same to rounding, and return None where the original has to decide: near a singularity, and for arrays of another
kind than the package makes.
"""

cimport numpy as cnp
from libc.math cimport INFINITY, cos, fabs, isfinite, sin, sqrt
from scipy.linalg.cython_lapack cimport dgetrf, dgetri

import numpy as np
from pinocchio import (
    LOCAL_WORLD_ALIGNED as WORLD,
    computeJointJacobians,
    forwardKinematics,
    getFrameClassicalAcceleration,
    getFrameJacobian,
    log3,
    updateFramePlacement,
)

cnp.import_array()


cdef inline double* data(cnp.ndarray x) noexcept:
    return <double*>cnp.PyArray_DATA(x)


cdef inline bint plain(x, Py_ssize_t size) noexcept:
    """Whether x is a float array of one dimension whose numbers lie side by side."""
    if not isinstance(x, cnp.ndarray):
        return False
    return (
        cnp.PyArray_NDIM(x) == 1
        and cnp.PyArray_TYPE(x) == cnp.NPY_DOUBLE
        and cnp.PyArray_DIM(x, 0) == size
        and (size <= 1 or cnp.PyArray_STRIDE(x, 0) == sizeof(double))
    )


cdef inline bint table(cnp.ndarray x, Py_ssize_t rows, Py_ssize_t columns) noexcept:
    """Whether x is a float array of this shape."""
    return (
        cnp.PyArray_NDIM(x) == 2
        and cnp.PyArray_TYPE(x) == cnp.NPY_DOUBLE
        and cnp.PyArray_DIM(x, 0) == rows
        and cnp.PyArray_DIM(x, 1) == columns
    )


cdef inline double entry(cnp.ndarray x, Py_ssize_t i, Py_ssize_t j) noexcept:
    return (<double*>(cnp.PyArray_BYTES(x) + i * cnp.PyArray_STRIDE(x, 0) + j * cnp.PyArray_STRIDE(x, 1)))[0]


cdef inline double dot(double* x, double* y, Py_ssize_t size) noexcept:
    cdef double total = 0.0
    cdef Py_ssize_t i
    for i in range(size):
        total += x[i] * y[i]
    return total


cdef inline cnp.ndarray empty(Py_ssize_t size):
    cdef cnp.npy_intp shape = size
    return cnp.PyArray_EMPTY(1, &shape, cnp.NPY_DOUBLE, 0)


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

    def __call__(self, cnp.ndarray J, cnp.ndarray F, cnp.ndarray dq):
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
    """

    cdef double *kp
    cdef double *kd
    cdef double *kp_v
    cdef double *kd_v
    cdef double *v

    def __init__(self, Vt, Qt, most, fast, kp, kd, kp_v, kd_v, v):
        super().__init__(Vt, Qt, most, fast)
        self.made_from += kp, kd, kp_v, kd_v, v
        vectors = tuple(np.array(given, dtype=float) for given in (kp, kd, kp_v, kd_v, v))
        self.kept += vectors
        self.kp, self.kd, self.kp_v, self.kd_v, self.v = (
            data(vectors[0]), data(vectors[1]), data(vectors[2]), data(vectors[3]), data(vectors[4])
        )

    def __call__(
        self,
        cnp.ndarray error,
        cnp.ndarray dz_d,
        cnp.ndarray ddz_d,
        cnp.ndarray J,
        cnp.ndarray drift,
        cnp.ndarray q,
        cnp.ndarray dq,
        cnp.ndarray more,
    ):
        """Acceleration and bound of the margin, as `Drive` has them.

        Args:
            error: Task error z_d − z.
            dz_d, ddz_d: What the task should do.
            J, drift: The task's Jacobian and its acceleration at ddq = 0.
            q, dq: State of the robot.
            more: What is asked of the self-motion beside this law, (r,), or None.
        """
        cdef Py_ssize_t n = self.n, m = self.m, r = n - m, i, j
        cdef double dz
        if not (
            plain(error, m) and plain(dz_d, m) and plain(ddz_d, m) and table(J, m, n) and plain(drift, m)
            and plain(q, n) and plain(dq, n) and (more is None or plain(more, r))
        ):
            return None
        for i in range(m):
            dz = 0.0
            for j in range(n):
                self.J[i * n + j] = entry(J, i, j)
                dz += self.J[i * n + j] * data(dq)[j]
            self.F[i] = (
                self.kp[i] * data(error)[i] + self.kd[i] * (data(dz_d)[i] - dz) + (data(ddz_d)[i] - data(drift)[i])
            )
        for i in range(r):
            self.F[m + i] = (
                self.kp_v[i] * (self.v[i] - dot(self.Vt + i * n, data(q), n))
                - self.kd_v[i] * dot(self.Vt + i * n, data(dq), n)
            )
            if more is not None:
                self.F[m + i] += data(more)[i]
        return self.solve(data(dq))


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


def waves(double t, cnp.ndarray frequencies, cnp.ndarray rows, Py_ssize_t first, Py_ssize_t second):
    cdef Py_ssize_t terms = cnp.PyArray_DIM(frequencies, 0), width = cnp.PyArray_DIM(rows, 1), i, k
    cdef cnp.ndarray z = empty(first), dz = empty(second - first), ddz = empty(width - second)
    cdef double *row = data(rows) + 2 * terms * width
    cdef double *out
    cdef double s = 0.0, c = 1.0
    for k in range(terms + 1):
        for i in range(width):
            out = data(z) + i if i < first else data(dz) + i - first if i < second else data(ddz) + i - second
            out[0] = row[i] if k == 0 else out[0] + s * row[i] + c * row[width + i]
        if k < terms:
            s, c = sin(data(frequencies)[k] * t), cos(data(frequencies)[k] * t)
            row = data(rows) + 2 * k * width
    return z, dz, ddz


cdef class Frame:
    """`FrameTask.value`, `linearize` and `at`.

    Args:
        model, workspace: What Pinocchio computes with.
        index: Number of the frame.
        part: Which numbers of the flat pose are the task point.
        rows: Which rows of velocities, accelerations and the Jacobian are the task's.
        point_type: What `at` returns its tuple as.
    """

    cdef object model, workspace, index, rest, point_type
    cdef tuple made_from
    cdef cnp.ndarray translation, rotation
    cdef Py_ssize_t part, part_step, size, row, row_step, m, n

    def __init__(self, model, workspace, index, part, rows, point_type):
        self.made_from = model, workspace, index, part, rows, point_type
        self.model, self.workspace, self.index, self.point_type = model, workspace, index, point_type
        self.n, self.rest = model.nv, np.zeros(model.nv)
        # Both stay where they are, and change with every pass.
        placement = workspace.oMf[index]
        self.translation, self.rotation = placement.translation, placement.rotation
        self.part, stop, self.part_step = part.indices(12)
        self.size = len(range(self.part, stop, self.part_step))
        self.row, stop, self.row_step = rows.indices(6)
        self.m = len(range(self.row, stop, self.row_step))

    def __reduce__(self):
        return type(self), self.made_from

    def value(self, q):
        forwardKinematics(self.model, self.workspace, q)
        return self.z()

    def linearize(self, q):
        computeJointJacobians(self.model, self.workspace, q)
        return self.z(), self.J()

    def at(self, q, dq):
        cdef cnp.ndarray dz = empty(self.m), drift = empty(self.m), velocity, J, a
        cdef Py_ssize_t i, j
        forwardKinematics(self.model, self.workspace, q, dq, self.rest)
        computeJointJacobians(self.model, self.workspace)
        z, J = self.z(), self.J()
        a = getFrameClassicalAcceleration(self.model, self.workspace, self.index, WORLD).vector
        velocity = dq if plain(dq, self.n) else np.array(dq, dtype=float)
        for i in range(self.m):
            data(drift)[i] = data(a)[self.row + i * self.row_step]
            data(dz)[i] = 0.0
            for j in range(self.n):
                data(dz)[i] += data(J)[i + self.m * j] * data(velocity)[j]
        return tuple.__new__(self.point_type, (z, J, dz, drift))

    cdef cnp.ndarray z(self):
        cdef cnp.ndarray z = empty(self.size)
        cdef Py_ssize_t i, k
        updateFramePlacement(self.model, self.workspace, self.index)
        for i in range(self.size):
            k = self.part + i * self.part_step
            data(z)[i] = data(self.translation)[k] if k < 3 else entry(self.rotation, k // 3 - 1, k % 3)
        return z

    cdef cnp.ndarray J(self):
        cdef cnp.npy_intp[2] shape = [self.m, self.n]
        cdef cnp.ndarray J = cnp.PyArray_EMPTY(2, shape, cnp.NPY_DOUBLE, 1)
        cdef cnp.ndarray whole = getFrameJacobian(self.model, self.workspace, self.index, WORLD)
        cdef Py_ssize_t i, j, k
        for j in range(self.n):
            for i in range(self.m):
                k = self.row + i * self.row_step
                # With one joint Pinocchio's bindings make a vector of what should be a column.
                data(J)[i + self.m * j] = data(whole)[k] if self.n == 1 else entry(whole, k, j)
        return J


def pose_difference(cnp.ndarray z1, cnp.ndarray z0):
    cdef cnp.npy_intp[2] shape = [3, 3]
    cdef cnp.ndarray R = cnp.PyArray_EMPTY(2, shape, cnp.NPY_DOUBLE, 0), delta = empty(6), turn
    cdef Py_ssize_t i, j
    if not (plain(z1, 12) and plain(z0, 12)):
        raise ValueError(f"two flat poses of 12 numbers are needed, got shapes {np.shape(z1)} and {np.shape(z0)}")
    for i in range(3):
        data(delta)[i] = data(z1)[i] - data(z0)[i]
        for j in range(3):
            data(R)[3 * i + j] = dot(data(z1) + 3 + 3 * i, data(z0) + 3 + 3 * j, 3)
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


def on_chart_inverse(cnp.ndarray J, cnp.ndarray U):
    cdef int n = cnp.PyArray_DIM(U, 0), m = cnp.PyArray_DIM(U, 1), room = 16 * m, info = 0
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


def newton_step(cnp.ndarray base, cnp.ndarray U, cnp.ndarray u, cnp.ndarray B, cnp.ndarray error):
    cdef Py_ssize_t n = cnp.PyArray_DIM(U, 0), m = cnp.PyArray_DIM(U, 1), i, j
    cdef cnp.ndarray u_next = empty(m), q = empty(n)
    for i in range(m):
        data(u_next)[i] = data(u)[i]
        for j in range(m):
            data(u_next)[i] += entry(B, i, j) * data(error)[j]
    for i in range(n):
        data(q)[i] = data(base)[i]
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
