"""A look at a matrix that compiled modules share."""

from libc.math cimport fabs


cdef inline bint is_rotation(double* R, double tolerance) noexcept:
    """Whether a matrix, row by row, is a rotation to rounding."""
    cdef double off = 0.0, product
    cdef Py_ssize_t i, j
    for i in range(3):
        for j in range(3):
            product = R[i] * R[j] + R[3 + i] * R[3 + j] + R[6 + i] * R[6 + j]
            off = max(off, fabs(product - (i == j)))
    product = (
        R[0] * (R[4] * R[8] - R[5] * R[7]) - R[1] * (R[3] * R[8] - R[5] * R[6]) + R[2] * (R[3] * R[7] - R[4] * R[6])
    )
    return off <= tolerance and product > 0.0
