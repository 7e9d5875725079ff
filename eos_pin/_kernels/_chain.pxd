"""Kinematics of a tree of joints on plain arrays, shared by the compiled kernels."""

cdef enum:
    MOST_JOINTS = 64
    MOST_ROWS = 12
    MOST_PARTS = 6


#: Kinds of parts, as in `eos_pin._kernels.flat`.
cdef enum:
    POSITION = 0
    ORIENTATION = 1
    POSE = 2
    HEADING = 3
    AXIS = 4


cdef class Chain:
    cdef readonly int n, m, size
    cdef int active_count, parts
    cdef int active[MOST_JOINTS]
    cdef int parent[MOST_JOINTS]
    cdef int prismatic[MOST_JOINTS]
    cdef double fixed[12 * MOST_JOINTS]
    cdef int part_joint[MOST_PARTS]
    cdef int part_kind[MOST_PARTS]
    cdef int part_rows[MOST_PARTS]
    cdef int part_axes[3 * MOST_PARTS]
    cdef int part_size[MOST_PARTS]
    cdef double tips[12 * MOST_PARTS]
    cdef unsigned char moves[MOST_PARTS * MOST_JOINTS]
    cdef void place(self, const double* q, double* world, bint everything) noexcept nogil
    cdef void evaluate(self, const double* q, double* z, double* J) noexcept nogil
    cdef void difference(self, const double* z1, const double* z0, double* e) noexcept nogil
    cdef int descend(
        self, double* q, const double* z, const double* lower, const double* upper, double tol, int most, double* left
    ) noexcept nogil
