"""What the compiled twins share: looks at arrays that cost nothing."""

cimport numpy as cnp

cdef extern from *:
    """
    #define tuple_of(kind, arguments) PyTuple_Type.tp_new((PyTypeObject*)kind, arguments, NULL)
    """
    object tuple_of(object kind, object arguments)


cdef inline double* data(cnp.ndarray x) noexcept:
    return <double*>cnp.PyArray_DATA(x)


cdef inline bint plain(x, Py_ssize_t size) noexcept:
    """Whether x is a float array of one dimension whose numbers lie side by side."""
    if not isinstance(x, cnp.ndarray):
        return False
    return (
        cnp.PyArray_NDIM(x) == 1
        and cnp.PyArray_TYPE(x) == cnp.NPY_DOUBLE
        and cnp.PyArray_DIM(x, 0) == size
        and (size <= 1 or cnp.PyArray_STRIDE(x, 0) == sizeof(double))
    )


cdef inline bint table(cnp.ndarray x, Py_ssize_t rows, Py_ssize_t columns) noexcept:
    """Whether x is a float array of this shape."""
    return (
        cnp.PyArray_NDIM(x) == 2
        and cnp.PyArray_TYPE(x) == cnp.NPY_DOUBLE
        and cnp.PyArray_DIM(x, 0) == rows
        and cnp.PyArray_DIM(x, 1) == columns
    )


cdef inline double entry(cnp.ndarray x, Py_ssize_t i, Py_ssize_t j) noexcept:
    return (<double*>(cnp.PyArray_BYTES(x) + i * cnp.PyArray_STRIDE(x, 0) + j * cnp.PyArray_STRIDE(x, 1)))[0]


cdef inline double dot(double* x, double* y, Py_ssize_t size) noexcept:
    cdef double total = 0.0
    cdef Py_ssize_t i
    for i in range(size):
        total += x[i] * y[i]
    return total


cdef inline cnp.ndarray empty(Py_ssize_t size):
    cdef cnp.npy_intp shape = size
    return cnp.PyArray_EMPTY(1, &shape, cnp.NPY_DOUBLE, 0)


cdef inline named(kind, tuple parts):
    """A named tuple from its parts, without what its class does in Python."""
    return tuple_of(kind, (parts,))
