# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled twin of springs and dampers on (z, v); the sums are written in `plain_springs`."""

cimport numpy as cnp
from libc.math cimport sin, sqrt

from eos_pin._kernels._common cimport as_plain, as_table, data, dot, empty, entry

import numpy as np

cnp.import_array()


cdef class Springs:
    """`plain_springs.Springs`.

    Args:
        Wt: Rows of dv = Wᵀ dq, (r, n).
        K, D: Stiffness and damping, (n, n).
        z_d: Task point at which the springs of the task are at rest.
        minus: Difference of two task points; None for a vector task.
        turns: First rows of rotation vectors in that difference.
    """

    cdef int n, m, r
    cdef double *Wt
    cdef double *K
    cdef double *D
    cdef double *e
    cdef double *F
    cdef double *J
    cdef double *dw
    cdef object z_d, minus
    cdef tuple made_from, kept, turns

    def __init__(self, Wt, K, D, z_d, minus, turns):
        self.made_from = Wt, K, D, z_d, minus, turns
        self.r, self.n = Wt.shape
        self.m = self.n - self.r
        self.z_d, self.minus, self.turns = z_d, minus, tuple(turns)
        n = self.n
        matrices = tuple(np.array(given, dtype=float, order="C") for given in (Wt, K, D))
        self.kept = *matrices, *(np.zeros(size) for size in (n, n, self.m * n + 1, n))
        self.Wt, self.K, self.D, self.e, self.F, self.J, self.dw = (
            data(self.kept[0]), data(self.kept[1]), data(self.kept[2]), data(self.kept[3]), data(self.kept[4]),
            data(self.kept[5]), data(self.kept[6]),
        )

    def __reduce__(self):
        return type(self), self.made_from

    def __call__(self, velocities, point, jacobian, joints):
        """Torque, (n,).

        Args:
            velocities: Joint velocities.
            point: Task point.
            jacobian: Jacobian, (m, n).
            joints: Way to the joints at which the spring of the self-motion is at rest, (n,).
        """
        cdef Py_ssize_t n = self.n, m = self.m, r = self.r, i, j
        cdef cnp.ndarray dq = as_plain(velocities, n), away = as_plain(joints, n), J = as_table(jacobian, m, n)
        cdef cnp.ndarray error, one, other, tau = empty(n)
        cdef double half, factor, x, y, z, a, b, c
        if self.minus is None:
            one, other = as_plain(self.z_d, m), as_plain(point, m)
            for i in range(m):
                self.e[i] = data(one)[i] - data(other)[i]
        else:
            error = as_plain(self.minus(self.z_d, point), m)
            for i in range(m):
                self.e[i] = data(error)[i]
        for i in range(m):
            for j in range(n):
                self.J[i * n + j] = entry(J, i, j)
            self.dw[i] = dot(self.J + i * n, data(dq), n)
        for i in range(r):
            self.e[m + i] = dot(self.Wt + i * n, data(away), n)
            self.dw[m + i] = dot(self.Wt + i * n, data(dq), n)
        for start in self.turns:
            i = start
            a, b, c = self.e[i], self.e[i + 1], self.e[i + 2]
            half = 0.5 * sqrt(a * a + b * b + c * c)
            factor = sin(half) / half if half > 1e-4 else 1.0 - half * half / 6.0
            self.e[i], self.e[i + 1], self.e[i + 2] = a * factor, b * factor, c * factor
        for i in range(n):
            self.F[i] = dot(self.K + i * n, self.e, n)
        for start in self.turns:
            i = start
            a, b, c = self.e[i], self.e[i + 1], self.e[i + 2]
            x, y, z = self.F[i], self.F[i + 1], self.F[i + 2]
            # |ε|² = (a² + b² + c²)/4 leaves the size of η; it is at least 0 as rotation vectors are at most π long.
            factor = sqrt(max(0.0, 1.0 - 0.25 * (a * a + b * b + c * c)))
            self.F[i] = factor * x - 0.5 * (b * z - c * y)
            self.F[i + 1] = factor * y - 0.5 * (c * x - a * z)
            self.F[i + 2] = factor * z - 0.5 * (a * y - b * x)
        for i in range(n):
            self.F[i] -= dot(self.D + i * n, self.dw, n)
        for j in range(n):
            x = 0.0
            for i in range(m):
                x += self.J[i * n + j] * self.F[i]
            for i in range(r):
                x += self.Wt[i * n + j] * self.F[m + i]
            data(tau)[j] = x
        return tau
