"""Names of earlier versions: each raises an error that has the new name."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from checks import tip

import eos_pin
from eos_pin import (
    Atlas,
    Avoidance,
    Chart,
    Clearance,
    ControlLoop,
    Damp,
    EosController,
    ExtendedDynamics,
    Hold,
    IkSolution,
    JointLimits,
    LimitedEosController,
    MujocoPlant,
    OperationalSpaceController,
    PositionTask,
    Result,
    Trial,
    pose_spline,
    simulate,
    simulate_extended,
    simulate_sampled,
)
from eos_pin.cli.main import main
from eos_pin.errors import EosError, OldNameError, Renamed, renamed


class Arm:
    """Something with an old attribute."""

    length = 1.0
    size = Renamed("length")


def test_renamed_attribute_raises_on_the_class_and_on_its_instances():
    for owner in (Arm, Arm()):
        with pytest.raises(OldNameError, match=r"^Arm\.size was renamed: use length$"):
            _ = owner.size
        assert not hasattr(owner, "size")
    with pytest.raises(OldNameError, match="use length"):
        Arm().size = 2.0
    assert issubclass(OldNameError, EosError)


def test_renamed_argument_raises_and_new_ones_pass():
    @renamed(rate="record_rate")
    def run(record_rate=1.0):
        """Docstring."""
        return record_rate

    @renamed(margin="distance")
    class Law:
        def __init__(self, distance=0.1):
            self.distance = distance

    assert (run(), run(2.0), run(record_rate=3.0), run.__doc__) == (1.0, 2.0, 3.0, "Docstring.")
    assert (Law().distance, Law(distance=2.0).distance) == (0.1, 2.0)
    with pytest.raises(OldNameError, match=r"the argument 'rate' of \S*run was renamed: use 'record_rate'"):
        run(rate=2.0)
    with pytest.raises(OldNameError, match=r"the argument 'margin' of \S*Law was renamed: use 'distance'"):
        Law(margin=2.0)
    with pytest.raises(TypeError, match="unexpected"):
        run(speed=1.0)


#: Attributes of 0.1, and what each became.
ATTRIBUTES = [
    (Atlas, "reach", "solve"),
    (Avoidance, "margin", "influence_distance"),
    (Chart, "at", "from_base"),
    (Clearance, "approaches", "closest_pairs"),
    (ControlLoop, "given_up", "task_deficit"),
    (ControlLoop, "memory", "state"),
    (EosController, "given_up", "task_deficit"),
    (EosController, "observe", "evaluate"),
    (ExtendedDynamics, "at", "from_state"),
    (IkSolution, "merit", "score"),
    (IkSolution, "way", "strategy"),
    (JointLimits, "of", "from_robot"),
    (LimitedEosController, "given_up", "task_deficit"),
    (LimitedEosController, "period", "control_period"),
    (MujocoPlant, "of", "from_robot"),
    (OperationalSpaceController, "given_up", "task_deficit"),
    (Result, "given_up", "task_deficit"),
    (Result, "given_up_rows", "deficit_rows"),
    (Result, "given_up_seconds", "deficit_seconds"),
    (Result, "given_up_to_limits", "deficit_from_limits"),
    (Trial, "of", "from_settings"),
]


@pytest.mark.parametrize(("owner", "old", "new"), ATTRIBUTES, ids=lambda value: getattr(value, "__name__", value))
def test_old_attribute_names_the_new_one(owner, old, new):
    with pytest.raises(OldNameError, match=rf"\.{old} was renamed: use {new}$"):
        getattr(owner, old)


@pytest.mark.parametrize(
    ("make", "old", "new"),
    [
        (pose_spline, "positions", "poses"),
        (simulate, "rate", "record_rate"),
        (simulate_extended, "rate", "record_rate"),
        (simulate_sampled, "rate", "record_rate"),
        (simulate_sampled, "period", "control_period"),
        (LimitedEosController, "period", "control_period"),
        (Avoidance, "margin", "influence_distance"),
        (Clearance.potential, "margin", "influence_distance"),
        (Clearance.potential_gradient, "margin", "influence_distance"),
    ],
    ids=lambda value: getattr(value, "__qualname__", value),
)
def test_old_argument_names_the_new_one(make, old, new):
    with pytest.raises(OldNameError, match=rf"'{old}' of {make.__qualname__} was renamed: use '{new}'"):
        make(**{old: 0.1})


def test_old_attribute_of_a_loop_and_a_controller_cannot_be_assigned(panda):
    task, q = PositionTask(panda, tip(panda)), np.array([0.0, -0.4, 0.0, -2.0, 0.0, 1.6, 0.8])
    controller = LimitedEosController(task, Hold(task.value(q)), Damp())
    with pytest.raises(OldNameError, match="use control_period"):
        controller.period = 2e-3
    loop = ControlLoop(controller)
    assert not hasattr(loop, "memory")
    with pytest.raises(OldNameError, match="use state"):
        loop.memory = None


#: Public names of 0.1 that are gone, and a word of what the message advises.
NAMES = {
    "Approach": "ClosestPair",
    "BASELINES": "OperationalSpaceController",
    "Inverses": "JointPath",
    "Reached": "IkSolution",
    "TaskSpaceController": "OperationalSpaceController",
    "Together": "SumObjective",
    "control_torques": "controller.torque",
    "pseudoinverse": "numpy.linalg.pinv",
    "simulate_eos": "simulate_extended",
    "task_from": "task_from_description",
    "write_table": "eos_pin.experiments",
}


@pytest.mark.parametrize("old", NAMES)
def test_old_public_name_names_the_new_one(old):
    with pytest.raises(ImportError, match=rf"eos_pin\.{old} was renamed in 0\.2: use .*{NAMES[old]}"):
        getattr(eos_pin, old)


#: Modules of 0.1 that are no more, one of each room.
MODULES = ["atlas", "controllers", "describing", "extent", "interrupts", "notes", "pathfiles", "presets", "results"]
MODULES += ["report", "scene", "splines", "targets", "waypoints", "figures", "clearance", "compiled", "files"]


@pytest.mark.parametrize("old", MODULES)
def test_old_module_names_its_room(old):
    with pytest.raises(ModuleNotFoundError, match=rf"eos_pin\.{old} was renamed in 0\.2: use eos_pin\.") as caught:
        importlib.import_module(f"eos_pin.{old}")
    importlib.import_module(str(caught.value).rpartition(" ")[2])


@pytest.mark.parametrize("words", [["track", "panda", "--rate", "1000"], ["sweep", "panda", "--rate=100,200"]])
def test_old_option_names_the_new_one(words, capsys):
    assert main(words) == 2
    assert "--rate was renamed: use --control-rate" in capsys.readouterr().err
