# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Logarithms and exponentials of rotations and of directions, and the tangent bases of directions."""

from libc.math cimport atan2, cos, sin, sqrt

from eos_pin._kernels import flat

#: Axes of the frame of the pole of directions, row by row.
cdef double POLE[9]
for _i in range(9):
    POLE[_i] = flat.POLE.ravel()[_i]


cdef void rotation_vector(const double* R1, const double* R0, double* e) noexcept nogil:
    """Rotation vector of R1 R0ᵀ, by way of the quaternion: as exact near 0 and near π as elsewhere."""
    cdef double R[9]
    cdef double w, x, y, z, s, scale
    cdef int i, j
    for i in range(3):
        for j in range(3):
            R[3 * i + j] = R1[3 * i] * R0[3 * j] + R1[3 * i + 1] * R0[3 * j + 1] + R1[3 * i + 2] * R0[3 * j + 2]
    if R[0] + R[4] + R[8] > 0.0:
        w = 1.0 + R[0] + R[4] + R[8]
        x, y, z = R[7] - R[5], R[2] - R[6], R[3] - R[1]
    elif R[0] >= R[4] and R[0] >= R[8]:
        x = 1.0 + R[0] - R[4] - R[8]
        w, y, z = R[7] - R[5], R[1] + R[3], R[2] + R[6]
    elif R[4] >= R[8]:
        y = 1.0 - R[0] + R[4] - R[8]
        w, x, z = R[2] - R[6], R[1] + R[3], R[5] + R[7]
    else:
        z = 1.0 - R[0] - R[4] + R[8]
        w, x, y = R[3] - R[1], R[2] + R[6], R[5] + R[7]
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    s = sqrt(x * x + y * y + z * z)
    scale = 2.0 * atan2(s, w) / s if s > 0.0 else 0.0
    e[0], e[1], e[2] = scale * x, scale * y, scale * z


cdef void rotate(const double* e, const double* R, double* out) noexcept nogil:
    """R turned by the rotation vector e, again by way of the quaternion: 1 + 2w [v] + 2 [v]² is the turn."""
    cdef double angle = sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
    cdef double w = cos(0.5 * angle), s = sin(0.5 * angle) / angle if angle > 0.0 else 0.5
    cdef double x = s * e[0], y = s * e[1], z = s * e[2]
    cdef double a, b, c, p, q, r
    cdef int j
    for j in range(3):
        a, b, c = R[j], R[3 + j], R[6 + j]
        p, q, r = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
        out[j] = a + w * p + y * r - z * q
        out[3 + j] = b + w * q + z * p - x * r
        out[6 + j] = c + w * r + x * q - y * p


cdef void tangents(const double* a, double* E) noexcept nogil:
    """`eos_pin.tasks._sphere.basis`: the two tangent vectors at a direction, row by row."""
    cdef double x = a[0] * POLE[0] + a[1] * POLE[3] + a[2] * POLE[6]
    cdef double y = a[0] * POLE[1] + a[1] * POLE[4] + a[2] * POLE[7]
    cdef double z = a[0] * POLE[2] + a[1] * POLE[5] + a[2] * POLE[8]
    cdef double c = x * x + y * y
    cdef int i
    c = 1.0 / (1.0 + z) if z > 0.0 else (1.0 - z) / c if c > 0.0 else 0.0
    for i in range(3):
        E[i] = (1.0 - c * x * x) * POLE[3 * i] - c * x * y * POLE[3 * i + 1] - x * POLE[3 * i + 2]
        E[3 + i] = -c * x * y * POLE[3 * i] + (1.0 - c * y * y) * POLE[3 * i + 1] - y * POLE[3 * i + 2]


cdef void arc(const double* a1, const double* a0, double* e) noexcept nogil:
    """Logarithm on the sphere: the step from direction a0 to a1 in the basis of a0."""
    cdef double E[6]
    cdef double sine, angle
    tangents(a0, E)
    e[0] = E[0] * a1[0] + E[1] * a1[1] + E[2] * a1[2]
    e[1] = E[3] * a1[0] + E[4] * a1[1] + E[5] * a1[2]
    sine = sqrt(e[0] * e[0] + e[1] * e[1])
    angle = atan2(sine, a0[0] * a1[0] + a0[1] * a1[1] + a0[2] * a1[2])
    if sine > 0.0:
        e[0], e[1] = angle / sine * e[0], angle / sine * e[1]
    else:
        e[0], e[1] = angle, 0.0


cdef void follow_arc(const double* a, const double* e, double* out) noexcept nogil:
    """Exponential on the sphere: the direction that a step from a leads to."""
    cdef double E[6]
    cdef double angle = sqrt(e[0] * e[0] + e[1] * e[1]), length = 0.0
    cdef double c = cos(angle), s = sin(angle) / angle if angle > 0.0 else 1.0
    cdef int i
    tangents(a, E)
    for i in range(3):
        out[i] = c * a[i] + s * (e[0] * E[i] + e[1] * E[3 + i])
        length += out[i] * out[i]
    length = sqrt(length)
    for i in range(3):
        out[i] /= length
