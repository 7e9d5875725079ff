# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled twins of a control step: tasks of frames, the tracking law, and the drive.

What each computes is written in `plain_law`; here are the same sums without NumPy's price for a call. They give the same
to rounding, with the same status; arrays of another kind than the package makes are copied.
"""

cimport numpy as cnp
from libc.math cimport sqrt
from scipy.linalg.cython_lapack cimport dgetrf, dgetri

from eos_pin._kernels._common cimport as_plain, as_table, data, dot, empty, entry, named

import numpy as np
from pinocchio import (
    LOCAL_WORLD_ALIGNED as WORLD,
    computeJointJacobians,
    forwardKinematics,
    getFrameClassicalAcceleration,
    getFrameJacobian,
    updateFramePlacement,
)

from eos_pin._kernels import dispatch

cnp.import_array()

cdef int DONE = dispatch.DONE, UNDECIDED = dispatch.UNDECIDED


cdef class Frame:
    """`plain_law.Frame`.

    Args:
        model, workspace: Pinocchio model and its workspace.
        index: Number of the frame.
        part: Which numbers of the flat pose are the task point.
        rows: Which rows of velocities, accelerations and the Jacobian are the task's.
        point_type: Class of the tuple that `at` returns.
    """

    cdef object model, workspace, index, rest, point_type
    cdef tuple made_from
    cdef cnp.ndarray translation, rotation, jacobian, acceleration
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
        self.jacobian = getFrameJacobian(self.model, self.workspace, self.index, WORLD)
        return self.z(), self.J()

    def at(self, q, dq):
        cdef cnp.ndarray dz = empty(self.m), drift = empty(self.m), velocity = as_plain(dq, self.n)
        cdef Py_ssize_t i, j
        self.look(q, dq)
        for i in range(self.m):
            data(drift)[i], data(dz)[i] = self.drift_of(i), 0.0
            for j in range(self.n):
                data(dz)[i] += self.J_of(i, j) * data(velocity)[j]
        return named(self.point_type, (self.z(), self.J(), dz, drift))

    cdef look(self, q, dq):
        """The passes of `at`."""
        forwardKinematics(self.model, self.workspace, q, dq, self.rest)
        computeJointJacobians(self.model, self.workspace)
        self.jacobian = getFrameJacobian(self.model, self.workspace, self.index, WORLD)
        self.acceleration = getFrameClassicalAcceleration(self.model, self.workspace, self.index, WORLD).vector

    cdef inline double J_of(self, Py_ssize_t i, Py_ssize_t j) noexcept:
        cdef Py_ssize_t k = self.row + i * self.row_step
        # With one joint Pinocchio's bindings make a vector of what should be a column.
        return data(self.jacobian)[k] if self.n == 1 else entry(self.jacobian, k, j)

    cdef inline double drift_of(self, Py_ssize_t i) noexcept:
        return data(self.acceleration)[self.row + i * self.row_step]

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
        cdef Py_ssize_t i, j
        for j in range(self.n):
            for i in range(self.m):
                data(J)[i + self.m * j] = self.J_of(i, j)
        return J


def aligned(size):
    """Room for numbers that begins where vector units like it, so that sums have the same rounding every time."""
    room = np.zeros(size + 8)
    return room[(-room.ctypes.data % 64) // 8 :][:size]


cdef class AccelerationMap:
    """`plain_law.AccelerationMap`.

    Args:
        Wt: Rows Wᵀ that make dv of dq, (r, n).
        Vt: Transposed basis V of the null space at the base point, (r, n); Wt itself where they are equal.
        Qt: Transposed orthonormal basis Q of the columns of U, (m, n).
        factors: T and Y of the margin, (m, m) and (r, n); None where they are I and Vt.
        most: Square of the size of U B from which directions may fade.
        fast: Joint speed from which they fade earlier.
        runaway, braking: Joint speed beyond which self-motion is braked, and how much.
    """

    def __init__(self, Wt, Vt, Qt, factors, double most, double fast, double runaway, double braking):
        self.made_from = Wt, Vt, Qt, factors, most, fast, runaway, braking
        self.m, self.n = Qt.shape
        self.runaway, self.braking = runaway, braking
        m, n, self.room, self.most, self.fast = self.m, self.n, 16 * self.m, most, fast
        self.kept = *(np.array(basis, dtype=float, order="C") for basis in (Wt, Qt)), *map(
            aligned, (m * n, n, m * m, m, self.room)
        ), np.empty(m, np.intc)
        # Where W and V are equal one array stands for both.
        self.others = () if Vt is Wt else tuple(np.array(table, dtype=float, order="C") for table in (Vt, *factors))
        self.Wt, self.Qt, self.J, self.F, self.A, self.x, self.work = (
            data(self.kept[0]), data(self.kept[1]), data(self.kept[2]), data(self.kept[3]), data(self.kept[4]),
            data(self.kept[5]), data(self.kept[6]),
        )
        self.Vt, self.T, self.Yt = self.Wt, NULL, self.Wt
        if self.others:
            self.Vt, self.T, self.Yt = data(self.others[0]), data(self.others[1]), data(self.others[2])
        self.pivots = <int*>cnp.PyArray_DATA(self.kept[7])

    def __reduce__(self):
        return type(self), self.made_from

    def __call__(self, jacobian, asked, velocities):
        cdef cnp.ndarray J = as_table(jacobian, self.m, self.n), F = as_plain(asked, self.n)
        cdef cnp.ndarray dq = as_plain(velocities, self.n)
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
        cdef double speed = sqrt(dot(dq, dq, n)), beyond = 0.0, ratio = max(speed / self.fast, 1.0), part
        cdef Py_ssize_t i, j, k
        for i in range(m):
            for k in range(m):
                A[i + m * k] = dot(self.J + i * n, self.Qt + k * n, n)
        dgetrf(&m, &m, A, &m, self.pivots, &info)
        if info == 0:
            dgetri(&m, A, &m, self.pivots, self.work, &self.room, &info)
        cdef cnp.ndarray ddq = empty(n)
        if info != 0 or not dot(A, A, m * m) * ratio * ratio < self.most:
            return UNDECIDED, ddq, 0.0
        if speed > self.runaway:
            for k in range(r):
                self.F[m + k] -= self.braking * (speed - self.runaway) * dot(self.Wt + k * n, dq, n)
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
        # The squares of D = V − Q (JQ)⁻¹ J V, beyond those of V; of T (JQ)⁻¹ J Y where the metric is not the identity.
        for k in range(r):
            for i in range(m):
                self.x[i] = dot(self.J + i * n, self.Yt + k * n, n)
            for i in range(m):
                part = 0.0
                for j in range(m):
                    part += A[i + m * j] * self.x[j]
                if self.T is NULL:
                    beyond += part * part
                else:
                    self.F[i] = part
            if self.T is not NULL:
                for i in range(m):
                    part = dot(self.T + i * m, self.F, m)
                    beyond += part * part
        return DONE, ddq, 1.0 / sqrt(1.0 + beyond)


cdef class TrackingLaw(AccelerationMap):
    """`plain_law.TrackingLaw`; Eqs. (36), (45).

    Args:
        of_map: The arguments of the `AccelerationMap`.
        kp, kd: Gains of the task, (m,).
        kp_v, kd_v: Gains of the self-motion, (r,).
        v: Where Wᵀ q should be, (r,).
        at: `Task.at`, or the `Frame` of the task.
        minus: Difference of two task points; None for a vector task.
    """

    cdef double *kp
    cdef double *kd
    cdef double *kp_v
    cdef double *kd_v
    cdef double *v
    cdef object task_at, minus
    cdef Frame frame

    def __init__(self, of_map, kp, kd, kp_v, kd_v, v, at, minus):
        super().__init__(*of_map)
        self.made_from = of_map, kp, kd, kp_v, kd_v, v, at, minus
        self.task_at, self.minus, self.frame = at, minus, at if isinstance(at, Frame) else None
        vectors = tuple(np.array(given, dtype=float) for given in (kp, kd, kp_v, kd_v, v))
        self.kept += vectors
        self.kp, self.kd, self.kp_v, self.kd_v, self.v = (
            data(vectors[0]), data(vectors[1]), data(vectors[2]), data(vectors[3]), data(vectors[4])
        )

    def __call__(self, joints, velocities, z_d, dz, ddz, self_motion):
        """Status, acceleration and bound of the margin, as `AccelerationMap` has them, and the task's Jacobian.

        Args:
            joints, velocities: State of the robot.
            z_d, dz, ddz: Target of the task.
            self_motion: Acceleration asked of the self-motion beside this law, (r,), or None.
        """
        cdef Py_ssize_t n = self.n, m = self.m, r = n - m, i, j
        cdef cnp.ndarray q = as_plain(joints, n), dq = as_plain(velocities, n), dz_d = as_plain(dz, m)
        cdef cnp.ndarray ddz_d = as_plain(ddz, m), more = None if self_motion is None else as_plain(self_motion, r)
        cdef cnp.ndarray J, error, drift = None
        cdef double rate
        if self.frame is not None:
            self.frame.look(q, dq)
            z, J = self.frame.z(), self.frame.J()
        else:
            z, matrix, _, acceleration = self.task_at(q, dq)
            J, drift = as_table(matrix, m, n), as_plain(acceleration, m)
        error = difference(z_d, z, m) if self.minus is None else as_plain(self.minus(z_d, z), m)
        for i in range(m):
            rate = 0.0
            for j in range(n):
                self.J[i * n + j] = entry(J, i, j)
                rate += self.J[i * n + j] * data(dq)[j]
            self.F[i] = self.kp[i] * data(error)[i] + self.kd[i] * (data(dz_d)[i] - rate) + (
                data(ddz_d)[i] - (data(drift)[i] if self.frame is None else self.frame.drift_of(i))
            )
        for i in range(r):
            self.F[m + i] = (
                self.kp_v[i] * (self.v[i] - dot(self.Wt + i * n, data(q), n))
                - self.kd_v[i] * dot(self.Wt + i * n, data(dq), n)
            )
            if more is not None:
                self.F[m + i] += data(more)[i]
        driven = <tuple>self.solve(data(dq))
        return driven[0], driven[1], driven[2], J


cdef cnp.ndarray difference(z_d, z, Py_ssize_t m):
    """z_d − z."""
    cdef cnp.ndarray error = empty(m), one = as_plain(z_d, m), other = as_plain(z, m)
    cdef Py_ssize_t i
    for i in range(m):
        data(error)[i] = data(one)[i] - data(other)[i]
    return error
