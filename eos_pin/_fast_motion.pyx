# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled twins for motion: tasks of frames, curves, Newton's method, and the rate of the state."""

cimport numpy as cnp
from libc.math cimport cos, fabs, isfinite, sin
from scipy.linalg.cython_lapack cimport dgetrf, dgetri

from eos_pin._fast cimport as_plain, as_table, data, dot, empty, entry, named, plain, table

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
        return named(self.point_type, (z, J, dz, drift))

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


def flat_pose(cnp.ndarray array not None):
    cdef cnp.ndarray z = empty(12)
    cdef double *R = data(z) + 3
    cdef double size = 0.0, off = 0.0, product
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
    return z if isfinite(dot(data(z), data(z), 12)) and off <= 1e-14 and product > 0.0 else None


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


cdef class Curve:
    """`Waves`.

    Args:
        phase, frequencies, rows, first, second: As the function `waves` takes them, and the phase.
        target: What `Waves` returns its tuple as.
    """

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
