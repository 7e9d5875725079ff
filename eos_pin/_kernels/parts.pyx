# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled twins of smaller parts: the watch of a loop, curves, poses, Newton's method, the state's rate."""

cimport numpy as cnp
from libc.math cimport INFINITY, cos, fabs, isfinite, sin, sqrt
from scipy.linalg.cython_lapack cimport dgetrf, dgetri

from eos_pin._arrays._rotation cimport is_rotation
from eos_pin._kernels._common cimport as_plain, as_table, data, dot, empty, entry, named, plain, table

import numpy as np
from pinocchio import log3

cnp.import_array()



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
    return z if isfinite(dot(data(z), data(z), 12)) and is_rotation(R, tolerance) else None


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
