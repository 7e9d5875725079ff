"""The compiled core: plain float arrays in and out, explicit status; `kinematics.Kinematics` is its one dispatch.

`flat` turns a Pinocchio model into arrays; `_chain` computes and searches on them, `_trace` follows the self-motion.
`plain` and `tracing` do the same through the methods of a task, where there is no compiler or the task is not made of
frames.
"""

# First of all: extension modules take statuses from it, and it takes all of them.
from eos_pin._kernels import dispatch as dispatch
