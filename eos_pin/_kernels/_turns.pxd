"""Logarithms and exponentials of rotations and of directions, shared by the compiled kernels."""

cdef void rotation_vector(const double* R1, const double* R0, double* e) noexcept nogil
cdef void rotate(const double* e, const double* R, double* out) noexcept nogil
cdef void tangents(const double* a, double* E) noexcept nogil
cdef void arc(const double* a1, const double* a0, double* e) noexcept nogil
cdef void follow_arc(const double* a, const double* e, double* out) noexcept nogil
