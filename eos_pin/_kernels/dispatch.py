"""The choice between compiled and plain kernels.

A kernel is a function or a class that takes and returns plain arrays. Its plain form is written in NumPy, to be read.
Where it runs in every control step and NumPy's price for a call counts, `law.pyx`, `limits.pyx`, `parts.pyx` and
`springs.pyx` have a compiled form of the same name, with the same arguments and the same results to rounding
(`benchmarks/compiled.py`); `_ways.pyx` has that of the innermost loop of a search.
Without a compiler, and with EOS_PIN_COMPILED=0 in the environment, the plain forms do everything.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, TypeVar, cast

from eos_pin._arrays.extensions import extension

#: Extension modules, and all that is used of them.
COMPILED = {
    "law": ("AccelerationMap", "Frame", "TrackingLaw"),
    "limits": ("ChangeProgram", "Limits"),
    "parts": (
        "Curve", "StateMonitor", "flat_pose", "largest", "newton_step", "on_chart_inverse",
        "pose_difference", "state_rate", "within_limits_fast",
    ),
    "springs": ("Springs",),
    "_chain": ("Chain", "LARGEST"),
    "_solids": ("distances",),
    "_step": ("KinematicStep",),
    "_trace": ("nearest", "tangents", "trace"),
    "_ways": ("relaxed",),
}  # fmt: skip

#: Those of kernels whose plain forms `use_compiled` chooses between.
WITH_PLAIN_FORMS = ("law", "limits", "parts", "springs", "_ways")

#: Statuses of a kernel that cannot always answer: it did, its caller has to decide, or there is no answer.
DONE, UNDECIDED, NO_ANSWER = 0, 1, 2

#: The compiled functions and classes; None without.
kernels: Any = None
_modules = {name: extension(f"_kernels.{name}") for name in COMPILED}
if None not in _modules.values():
    kernels = SimpleNamespace(
        **{name: getattr(_modules[module], name) for module, names in COMPILED.items() for name in names}
    )

Kernel = TypeVar("Kernel", bound=Callable[..., Any])

#: The plain forms of what may be compiled, by name.
REFERENCES: dict[str, Callable[..., Any]] = {}


def use_compiled(plain: Kernel) -> Kernel:
    """Choose the compiled form of a kernel, where there is one.

    Args:
        plain: Its plain form, a function or a class; `COMPILED` must list its name.
    """
    name = plain.__name__
    assert any(name in COMPILED[module] for module in WITH_PLAIN_FORMS), (
        f"{name} is not in the list of what is compiled"
    )
    REFERENCES[name] = plain
    return cast(Kernel, plain if kernels is None else getattr(kernels, name))
