"""Pinocchio's workspace, also for robots with hundreds of joints."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

#: Up to this many joints Pinocchio's own workspace is small: 4 MB, made in 2 ms.
FULL = 50


def workspace(model: pin.Model) -> pin.Data:
    """Workspace in which Pinocchio computes kinematics and dynamics of `model`.

    Pinocchio's own has four arrays of n³ numbers for second derivatives, which nothing here asks for; with 1,000 joints
    they take 32 GB (stack-of-tasks/pinocchio#2949). Beyond `FULL` joints this one has no more than what the algorithms
    in `Robot` and in the tasks use. One that uses more finds an empty array and ends the process: each is tested.

    Args:
        model: Model whose joints all have one degree of freedom, or follow others.
    """
    if model.nv <= FULL or model.nv < model.njoints - 1:
        return pin.Data(model)
    data, n = pin.Data(), model.nv
    data.joints = [joint.createData() for joint in model.joints]
    for make, names in (
        (pin.SE3.Identity, "oMi liMi iMf"),
        (pin.Motion.Zero, "v a a_gf ov"),
        (pin.Force.Zero, "f h oh"),
        (pin.Inertia.Zero, "oYcrb"),
        (lambda: np.zeros((6, 6)), "B Yaba"),
        (lambda: np.zeros(3), "com vcom acom"),
        (float, "mass"),
    ):
        for name in names.split():
            setattr(data, name, [make() for _ in range(model.njoints)])
    data.oMf = [pin.SE3.Identity() for _ in range(model.nframes)]
    for rows, names in ((6, "J dJ Ag dFdv"), (3, "Jcom"), (n, "M C")):
        for name in names.split():
            setattr(data, name, np.zeros((rows, n)))
    for name in ("tau", "nle", "g", "ddq"):
        setattr(data, name, np.zeros(n))
    # Column i is that of joint i + 1; the column of its parent is −1 where that is the world.
    parents = [parent - 1 for parent in list(model.parents)[1:]]
    data.parents_fromRow, data.non_mimic_parents_fromRow, data.mimic_parents_fromRow = parents, parents, [-1] * n
    data.idx_vExtended_to_idx_v_fromRow = list(range(n))
    data.nvSubtree = [len(subtree) for subtree in model.subtrees]
    return data
