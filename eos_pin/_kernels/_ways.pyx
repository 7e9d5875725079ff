# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled twin of the costs from layer to layer in `eos_pin._kernels.ways`."""

import numpy as np


def relaxed(
    const double[:, ::1] value, const Py_ssize_t[::1] start, const Py_ssize_t[::1] end, const double[::1] cost, int count
):
    """`ways.relaxed`."""
    cdef Py_ssize_t S = value.shape[1], e, s
    cdef double c, v
    cdef int number
    cdef const double* before
    cdef double* best
    cdef int* come
    found, via = np.full((count, S), np.inf), np.full((count, S), -1, dtype=np.intc)
    cdef double[:, ::1] out = found
    cdef int[:, ::1] back = via
    if S and count:
        with nogil:
            for e in range(start.shape[0]):
                before, best, come = &value[start[e], 0], &out[end[e], 0], &back[end[e], 0]
                number, c = <int>start[e], cost[e]
                for s in range(S):
                    v = before[s] + c
                    if v < best[s]:
                        best[s] = v
                        come[s] = number
    return found, via
