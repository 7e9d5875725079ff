"""Compiles the twins of formulas that run in every step, where there is a C compiler.

Without one the package does the same, more slowly. All else about the package is in `pyproject.toml`.
"""

import numpy as np
from setuptools import Extension, setup

KERNELS = ("law", "limits", "parts", "_turns", "_chain", "_solids", "_step", "_trace", "_ways", "springs")

setup(
    ext_modules=[
        Extension(
            f"eos_pin.{name}",
            [f"eos_pin/{name.replace('.', '/')}.pyx"],
            include_dirs=[np.get_include()],
            define_macros=[("NPY_NO_DEPRECATED_API", "NPY_2_0_API_VERSION")],
            optional=True,
        )
        for name in ("_arrays._border", *(f"_kernels.{kernel}" for kernel in KERNELS))
    ]
)
