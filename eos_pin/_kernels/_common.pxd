"""What the compiled twins share: looks at arrays that cost nothing."""

cimport numpy as cnp

import numpy as np

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


cdef inline cnp.ndarray as_plain(x, Py_ssize_t size):
    """x, or a float copy whose numbers lie side by side."""
    if plain(x, size):
        return x
    copy = np.ascontiguousarray(x, dtype=float)
    if copy.shape != (size,):
        raise ValueError(f"a vector of {size} numbers is needed, got shape {copy.shape}")
    return copy


cdef inline bint table(cnp.ndarray x, Py_ssize_t rows, Py_ssize_t columns) noexcept:
    """Whether x is a float array of this shape."""
    return (
        cnp.PyArray_NDIM(x) == 2
        and cnp.PyArray_TYPE(x) == cnp.NPY_DOUBLE
        and cnp.PyArray_DIM(x, 0) == rows
        and cnp.PyArray_DIM(x, 1) == columns
    )


cdef inline cnp.ndarray as_table(x, Py_ssize_t rows, Py_ssize_t columns):
    """x, or a copy of floats."""
    if isinstance(x, cnp.ndarray) and table(x, rows, columns):
        return x
    copy = np.array(x, dtype=float)
    if copy.shape != (rows, columns):
        raise ValueError(f"a matrix of {rows} x {columns} numbers is needed, got shape {copy.shape}")
    return copy


cdef inline double entry(cnp.ndarray x, Py_ssize_t i, Py_ssize_t j) noexcept:
    return (<double*>(cnp.PyArray_BYTES(x) + i * cnp.PyArray_STRIDE(x, 0) + j * cnp.PyArray_STRIDE(x, 1)))[0]


cdef inline double dot(double* x, double* y, Py_ssize_t size) noexcept nogil:
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
