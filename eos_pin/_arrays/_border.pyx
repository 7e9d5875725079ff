# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False, binding=True
"""The compiled form of what `border.py` does at every call: the arguments are recognized, and the function is called."""

cimport numpy as cnp
from cpython.object cimport PyObject_Call
from libc.math cimport INFINITY, isfinite

from eos_pin._arrays._rotation cimport is_rotation

import functools

from eos_pin._arrays.annotations import FEW, Never
from eos_pin._arrays.arrays import ORTHONORMAL
cnp.import_array()

cdef double ROUNDING = ORTHONORMAL


def bordered(function, border):
    """`border.bordered`, with the same arguments."""
    cdef Accepted accepted = None

    @functools.wraps(function)
    def wrapper(*args, **kwargs):
        nonlocal accepted
        if accepted is None:
            accepted = border.accepted
        if not accepted.holds(args, kwargs):
            args, kwargs = border.converted(args, kwargs)
        return PyObject_Call(function, args, kwargs)

    wrapper.unchecked, wrapper.border = function, border
    return wrapper


cdef class Accepted:
    """`border.Accepted`, with the same arguments."""

    cdef tuple names
    cdef list entries

    def __init__(self, tuple names):
        self.names, self.entries = names, []

    def __reduce__(self):
        return type(self), (self.names,)

    def remember(self, owner, marks):
        known = [entry for entry in self.entries if entry[0]() is not None]
        for one, _, before in known:
            if one() is owner():
                marks = before | marks
        others = [entry for entry in known if entry[0]() is not owner()]
        # In the order of the parameters, and by their names.
        self.entries = [(owner, tuple([marks.get(name, Never) for name in self.names]), marks), *others][:FEW]

    def __call__(self, tuple args, dict kwargs):
        return self.holds(args, kwargs)

    cdef bint holds(self, tuple args, dict kwargs) except -1:
        cdef Py_ssize_t i, count = len(args)
        cdef tuple entry, marks
        if count == 0 or count > len(self.names):
            return False
        for entry in self.entries:
            if entry[0]() is not args[0]:
                continue
            marks = entry[1]
            for i in range(count):
                if not recognized(args[i], marks[i]):
                    return False
            for name in kwargs:
                if not recognized(kwargs[name], (<dict>entry[2]).get(name, Never)):
                    return False
            return True
        return False


cdef bint recognized(value, mark) except -1:
    cdef double number
    if mark is None:
        return True
    if type(mark) is tuple:
        return is_array(value, (<tuple>mark)[0], (<tuple>mark)[1])
    if type(mark) is float:
        if type(value) is not float:
            return False
        number = value
        return <double>mark < number < INFINITY
    return type(value) is mark


cdef bint is_array(value, tuple shape, tuple rotations) except -1:
    cdef Py_ssize_t k, size = 1
    cdef double *x
    if type(value) is not cnp.ndarray:
        return False
    array = <cnp.ndarray>value
    if cnp.PyArray_TYPE(array) != cnp.NPY_DOUBLE or cnp.PyArray_NDIM(array) != len(shape):
        return False
    if not (cnp.PyArray_ISCARRAY_RO(array) or cnp.PyArray_ISFORTRAN(array)) or not cnp.PyArray_ISBEHAVED_RO(array):
        return False
    for k in range(len(shape)):
        if cnp.PyArray_DIM(array, k) != <Py_ssize_t>shape[k]:
            return False
        size *= cnp.PyArray_DIM(array, k)
    x = <double*>cnp.PyArray_DATA(array)
    for k in range(size):
        if not isfinite(x[k]):
            return False
    for start in rotations:
        if not is_rotation(x + <Py_ssize_t>start, ROUNDING):
            return False
    return True
