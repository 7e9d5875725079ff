# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Continuation along the self-motion of a task with one redundant joint, as in `eos_pin._kernels.tracing`."""

from libc.math cimport cos, fabs, isfinite, round, sqrt
from libc.string cimport memcpy, memset

from eos_pin._kernels._chain cimport MOST_JOINTS, MOST_PARTS, MOST_ROWS, Chain

import numpy as np

from eos_pin._kernels import tracing

#: Ends of a trace, as in `eos_pin._kernels.tracing`.
cdef enum:
    CLOSED = 0
    SINGULAR = 1
    LONG = 2

cdef double TAU = 6.283185307179586, REGULAR = tracing.REGULAR


cdef struct Point:
    double q[MOST_JOINTS]
    double t[MOST_JOINTS]
    double step[MOST_JOINTS]
    double error
    double least


cdef inline double dot(const double* x, const double* y, int n) noexcept nogil:
    cdef double total = 0.0
    cdef int i
    for i in range(n):
        total += x[i] * y[i]
    return total


cdef void look(Chain chain, const double* z, Point* p) noexcept nogil:
    """At p.q: the task error, the shortest step that removes it, and the unit vector of the self-motion.

    By Householder's reflections of G'ᵀ = Q R. The vector's sign is that of det [G'; tᵀ], so that it is continuous along
    the self-motion and turns round across a singularity, and between branches that pass close by each other.
    """
    cdef double J[MOST_ROWS * MOST_JOINTS]
    cdef double point[12 * MOST_PARTS]
    cdef double e[MOST_ROWS]
    cdef double diagonal[MOST_ROWS]
    cdef double beta[MOST_ROWS]
    cdef double norm, most = 0.0, sign = 1.0
    cdef int n = chain.n, m = chain.m, i, j, k
    cdef double* v
    chain.evaluate(p.q, point, J)
    chain.difference(z, point, e)
    p.error, p.least = 0.0, 1e300
    for i in range(m):
        p.error = max(p.error, fabs(e[i])) if isfinite(e[i]) else 1e300
        v = &J[i * n + i]
        norm = sqrt(dot(v, v, n - i))
        diagonal[i] = -norm if v[0] > 0.0 else norm
        most, p.least = max(most, norm), min(p.least, norm)
        v[0] -= diagonal[i]
        norm = dot(v, v, n - i)
        beta[i] = 2.0 / norm if norm > 0.0 else 0.0
        sign = sign if diagonal[i] < 0.0 else -sign
        for j in range(i + 1, m):
            norm = beta[i] * dot(v, &J[j * n + i], n - i)
            for k in range(n - i):
                J[j * n + i + k] -= norm * v[k]
    p.least = p.least / most if most > 0.0 else 0.0
    memset(p.step, 0, n * sizeof(double))
    memset(p.t, 0, n * sizeof(double))
    p.t[n - 1] = sign
    if p.least == 0.0:
        return
    for i in range(m):
        p.step[i] = (e[i] - dot(&J[i * n], p.step, i)) / diagonal[i]
    for i in range(m - 1, -1, -1):
        v = &J[i * n + i]
        norm = beta[i] * dot(v, &p.step[i], n - i)
        for k in range(n - i):
            p.step[i + k] -= norm * v[k]
        norm = beta[i] * dot(v, &p.t[i], n - i)
        for k in range(n - i):
            p.t[i + k] -= norm * v[k]


cdef bint correct(Chain chain, const double* z, Point* p, double most, double tol) noexcept nogil:
    """Newton's method from p.q to the self-motion; False where it leads further away than `most` or does not converge."""
    cdef double way
    cdef int iteration, i
    for iteration in range(8):
        look(chain, z, p)
        if p.error <= tol:
            return p.least > 0.0
        way = sqrt(dot(p.step, p.step, chain.n))
        if not way <= most:
            return False
        most -= 0.5 * way
        for i in range(chain.n):
            p.q[i] += p.step[i]
    return False


cdef inline void predict(Point* ahead, Point* here, double* bend, double h, int n) noexcept nogil:
    cdef int i
    for i in range(n):
        ahead.q[i] = here.q[i] + h * (here.t[i] + 0.5 * h * bend[i])


def tangents(Chain chain, const double[:, ::1] Q, const double[::1] z):
    """Unit vectors of the self-motion, (K, n), and how regular each state is, 0 at a singularity."""
    T, regular = np.empty((Q.shape[0], chain.n)), np.empty(Q.shape[0])
    cdef double[:, ::1] t = T
    cdef double[::1] least = regular
    cdef Point p
    cdef Py_ssize_t k
    with nogil:
        for k in range(Q.shape[0]):
            memcpy(p.q, &Q[k, 0], chain.n * sizeof(double))
            look(chain, &z[0], &p)
            memcpy(&t[k, 0], p.t, chain.n * sizeof(double))
            least[k] = p.least
    return T, regular


def trace(Chain chain, const double[::1] start, const double[::1] z, const unsigned char[::1] revolute, double direction,
          double step, double turn, double length, double shortest, double tol, int most):
    """`eos_pin._kernels.tracing.trace`: joints and unit vectors of the nodes, and how the trace ended."""
    Q, T = np.empty((most, chain.n)), np.empty((most, chain.n))
    cdef double[:, ::1] q = Q
    cdef double[:, ::1] t = T
    cdef Point here, ahead, landing
    cdef double bend[MOST_JOINTS]
    cdef double way[MOST_JOINTS]
    cdef double h = 0.1 * step, taken, angle, fastest, travelled = 0.0, least_cosine = cos(turn), target
    cdef int n = chain.n, i, count = 1, status = LONG, attempt
    cdef bint good
    memcpy(here.q, &start[0], n * sizeof(double))
    look(chain, &z[0], &here)
    if here.least < REGULAR:
        return Q[:0], T[:0], SINGULAR
    with nogil:
        for i in range(n):
            here.t[i] *= direction
            bend[i] = 0.0
        memcpy(&q[0, 0], here.q, n * sizeof(double))
        memcpy(&t[0, 0], here.t, n * sizeof(double))
        while travelled < length and count < most - 1:
            fastest = 0.0
            for i in range(n):
                fastest = max(fastest, fabs(here.t[i]))
            h = min(h, step / fastest)
            predict(&ahead, &here, bend, h, n)
            good = correct(chain, &z[0], &ahead, 0.2 * h, tol)
            if good:
                for i in range(n):
                    ahead.t[i] *= direction
                    way[i] = ahead.q[i] - here.q[i]
                good = dot(here.t, ahead.t, n) >= least_cosine and dot(way, here.t, n) > 0.5 * h
            if not good:
                h *= 0.5
                if h < shortest:
                    status = SINGULAR
                    break
                continue
            taken = sqrt(dot(way, way, n))
            # The start lies within this step: go there exactly, and see whether it is the start.
            target = 0.0
            for i in range(n):
                way[i] = q[0, i] - here.q[i]
                if revolute[i]:
                    way[i] -= TAU * round(way[i] / TAU)
            target = dot(way, here.t, n)
            if count > 2 and 0.0 < target <= 1.01 * taken and dot(way, way, n) <= 2.25 * taken * taken:
                for i in range(n):
                    way[i] += here.q[i]
                for attempt in range(5):
                    predict(&landing, &here, bend, target, n)
                    if not correct(chain, &z[0], &landing, 0.2 * h, tol):
                        break
                    angle = 0.0
                    for i in range(n):
                        angle += direction * landing.t[i] * (way[i] - landing.q[i])
                    target += angle
                    if fabs(angle) < 1e-9:
                        break
                angle = 0.0
                for i in range(n):
                    angle = max(angle, fabs(way[i] - landing.q[i]))
                if angle <= 1e-6:
                    memcpy(&q[count, 0], way, n * sizeof(double))
                    memcpy(&t[count, 0], &t[0, 0], n * sizeof(double))
                    count += 1
                    status = CLOSED
                    break
            angle = 0.0
            for i in range(n):
                bend[i] = (ahead.t[i] - here.t[i]) / taken
                angle += (ahead.t[i] - here.t[i]) * (ahead.t[i] - here.t[i])
            angle = sqrt(angle)
            travelled += taken
            here = ahead
            memcpy(&q[count, 0], here.q, n * sizeof(double))
            memcpy(&t[count, 0], here.t, n * sizeof(double))
            count += 1
            h = taken * min(2.0, 0.7 * turn / angle if angle > 0.35 * turn else 2.0)
    return Q[:count].copy(), T[:count].copy(), status


def nearest(const double[:, ::1] Q, const double[:, ::1] T, const double[:, ::1] nodes, const double[:, ::1] units,
            const unsigned char[::1] revolute):
    """`eos_pin._kernels.tracing.nearest`."""
    numbers, differences = np.full(Q.shape[0], -1, dtype=np.int64), np.full((Q.shape[0], Q.shape[1]), np.inf)
    cdef long long[::1] number = numbers
    cdef double[:, ::1] gap = differences
    cdef double x, square, best
    cdef Py_ssize_t k, i, j, n = Q.shape[1]
    with nogil:
        for k in range(Q.shape[0]):
            best = 1e300
            for i in range(nodes.shape[0]):
                square = 0.0
                for j in range(n):
                    x = Q[k, j] - nodes[i, j]
                    if revolute[j]:
                        x -= TAU * round(x / TAU)
                    square += x * x
                    if square >= best:
                        break
                if square < best and dot(&T[k, 0], &units[i, 0], <int>n) > 0.0:
                    best, number[k] = square, i
            if number[k] >= 0:
                for j in range(n):
                    x = Q[k, j] - nodes[number[k], j]
                    gap[k, j] = x - TAU * round(x / TAU) if revolute[j] else x
    return numbers, differences
