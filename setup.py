"""Compiles `eos_pin/_kernels.pyx` where there is a C compiler; without one the package does the same, more slowly.

All else about the package is in `pyproject.toml`.
"""

import numpy as np
from setuptools import Extension, setup

setup(
    ext_modules=[
        Extension(
            "eos_pin._kernels",
            ["eos_pin/_kernels.pyx"],
            include_dirs=[np.get_include()],
            define_macros=[("NPY_NO_DEPRECATED_API", "NPY_2_0_API_VERSION")],
            optional=True,
        )
    ]
)
