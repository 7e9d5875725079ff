# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Distances between line segments and boxes; `eos_pin.planning.distances` has the same in NumPy, and explains it."""

from libc.math cimport fabs, sqrt

import numpy as np


cdef inline double clip(double x, double low, double high) noexcept nogil:
    return low if x < low else high if x > high else x


cdef inline double dot(const double* a, const double* b) noexcept nogil:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


cdef double between(const double* a0, const double* a1, const double* b0, const double* b1) noexcept nogil:
    """Distance of two segments."""
    cdef double u[3]
    cdef double v[3]
    cdef double w[3]
    cdef double a, b, c, d, e, det, s, t, x, total = 0.0
    cdef int i
    for i in range(3):
        u[i], v[i], w[i] = a1[i] - a0[i], b1[i] - b0[i], a0[i] - b0[i]
    a, b, c, d, e = dot(u, u), dot(u, v), dot(v, v), dot(u, w), dot(v, w)
    det = a * c - b * b
    s = clip((b * e - c * d) / det, 0.0, 1.0) if det > 1e-12 * max(a * c, 1e-300) else 0.0
    t = clip((b * s + e) / max(c, 1e-300), 0.0, 1.0)
    s = clip((b * t - d) / max(a, 1e-300), 0.0, 1.0)
    for i in range(3):
        x = w[i] + s * u[i] - t * v[i]
        total += x * x
    return sqrt(total)


cdef inline double rise(const double* a, const double* d, const double* half, double t) noexcept nogil:
    """Half the slope of the squared distance at a + t d."""
    cdef double total = 0.0, x
    cdef int i
    for i in range(3):
        x = a[i] + t * d[i]
        total += (x - clip(x, -half[i], half[i])) * d[i]
    return total


cdef double to_box(const double* a, const double* b, const double* half) noexcept nogil:
    """Distance of a segment from a box about the origin; minus the depth where they meet."""
    cdef double d[3]
    cdef double low = 0.0, high = 1.0, at_low, at_high, t, r, x, total = 0.0, deep, depth
    cdef int i, side, k
    for i in range(3):
        d[i] = b[i] - a[i]
    at_low, at_high = rise(a, d, half, 0.0), rise(a, d, half, 1.0)
    for i in range(3):
        if fabs(d[i]) <= 1e-12:
            continue
        for side in range(2):
            t = ((half[i] if side else -half[i]) - a[i]) / d[i]
            if low < t < high:
                r = rise(a, d, half, t)
                if r >= 0.0:
                    high, at_high = t, r
                else:
                    low, at_low = t, r
    if at_low >= 0.0:
        t = low
    elif at_high < 0.0:
        t = high
    else:
        t = low + (high - low) * clip(-at_low / (at_high - at_low) if at_high > at_low else 0.5, 0.0, 1.0)
    for i in range(3):
        x = fabs(a[i] + t * d[i]) - half[i]
        if x > 0.0:
            total += x * x
    total = sqrt(total)
    if total > 1e-12:
        return total
    depth = 0.0
    for k in range(9):
        deep = -1e300
        for i in range(3):
            deep = max(deep, fabs(a[i] + 0.125 * k * d[i]) - half[i])
        depth = min(depth, deep)
    return depth


def distances(
    const double[:, :, ::1] ends, const double[::1] radii, const int[:, ::1] own, const int[:, ::1] boxed,
    const double[:, ::1] centres, const double[:, :, ::1] axes, const double[:, ::1] halves,
    const int[:, ::1] capped, const double[:, :, ::1] capsules, const double[::1] others,
):
    """Distances of capsules from each other, from boxes and from capsules at rest, (pairs, K).

    Args:
        ends: Ends of the capsules' segments, (K, 2 × capsules, 3).
        radii: Their radii.
        own: Pairs of capsules, (p, 2).
        boxed: Pairs of a capsule and a box, (p, 2).
        centres: Centres of the boxes.
        axes: Rows: the axes of the boxes.
        halves: Half sizes of the boxes.
        capped: Pairs of a capsule and one at rest, (p, 2).
        capsules: Ends of those at rest, (k, 2, 3).
        others: Their radii.
    """
    cdef Py_ssize_t K = ends.shape[0], k, p, row
    cdef int i, j, c, side
    cdef double x[3]
    cdef double local[6]
    out = np.empty((own.shape[0] + boxed.shape[0] + capped.shape[0], K))
    cdef double[:, ::1] D = out
    with nogil:
        for k in range(K):
            row = 0
            for p in range(own.shape[0]):
                i, j = own[p, 0], own[p, 1]
                D[row, k] = between(&ends[k, 2 * i, 0], &ends[k, 2 * i + 1, 0], &ends[k, 2 * j, 0], &ends[k, 2 * j + 1, 0])
                D[row, k] -= radii[i] + radii[j]
                row += 1
            for p in range(boxed.shape[0]):
                i, j = boxed[p, 0], boxed[p, 1]
                for side in range(2):
                    for c in range(3):
                        x[c] = ends[k, 2 * i + side, c] - centres[j, c]
                    for c in range(3):
                        local[3 * side + c] = dot(&axes[j, c, 0], x)
                D[row, k] = to_box(local, &local[3], &halves[j, 0]) - radii[i]
                row += 1
            for p in range(capped.shape[0]):
                i, j = capped[p, 0], capped[p, 1]
                D[row, k] = between(&ends[k, 2 * i, 0], &ends[k, 2 * i + 1, 0], &capsules[j, 0, 0], &capsules[j, 1, 0])
                D[row, k] -= radii[i] + others[j]
                row += 1
    return out
