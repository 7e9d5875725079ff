"""The map from commanded to joint accelerations, for other kernels that need it."""

cdef class AccelerationMap:
    cdef int n, m, room
    cdef double most, fast, runaway, braking
    cdef double *Wt
    cdef double *Vt
    cdef double *Yt
    cdef double *T
    cdef double *Qt
    cdef double *J
    cdef double *F
    cdef double *A
    cdef double *x
    cdef double *work
    cdef int *pivots
    cdef tuple made_from, kept, others
    cdef solve(self, double* dq)
