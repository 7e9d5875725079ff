"""Nothing is ignored silently: an option that changes nothing is refused, and what is not known is told."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
from dataclasses import fields
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

from eos_pin import (
    Avoidance,
    Clearance,
    Controller,
    ControlLoop,
    Damp,
    EosController,
    Friction,
    Hold,
    InputError,
    KinematicLoop,
    LimitedEosController,
    Obstacle,
    PoseTask,
    PositionTask,
    StackedTask,
    Task,
    inverse_kinematics,
    load_robot,
    self_motion_manifold,
    simulate,
    simulate_sampled,
)
from eos_pin.cli.main import main
from eos_pin.cli.output import console
from eos_pin.cli.tables import run_table
from eos_pin.experiments.applicability import RULES
from eos_pin.experiments.defaults import fitting_path, make_task, rest_posture
from eos_pin.experiments.options import ControlOptions, PathOptions, RunOptions, TaskOptions

pytestmark = pytest.mark.usefixtures("unchecked")

#: Modules of commands that are not called like them.
MODULES = {"compare": "track", "robots": "replay", "sweep": "many.sweep"}

REFUSED = [
    ("track panda --path hold --size 0.1", "--size 0.1 does not apply: it belongs to the paths eight, circle and line"),
    ("track panda --path hold --plane yz", "--plane yz does not apply"),
    ("track panda --path hold --period 5", "--period 5.0 does not apply"),
    ("track panda --path hold --cycles 5", "--cycles 5 does not apply: a robot that holds still has no rounds"),
    ("track panda --path some.csv --size 0.1", "--size 0.1 does not apply"),
    ("track panda --path some.csv --plane yz", "--plane yz does not apply"),
    ("track panda --path some.csv --period 3", "--period 3.0 does not apply"),
    ("track panda --corners stop", "--corners stop does not apply: it belongs to way points"),
    ("track panda --path some.csv --blend 0.1", "--blend 0.1 does not apply: it belongs to --corners round"),
    ("compare panda --path hold --corners round", "--corners round does not apply"),
    ("compare panda --path some.csv --blend 0.1", "--blend 0.1 does not apply"),
    ("track panda --cycles 5 --duration 9", "--cycles 5 does not apply: the duration is given"),
    ("compare panda --cycles 5 --duration 9", "--cycles 5 does not apply"),
    ("compare panda --path hold --size 0.1", "--size 0.1 does not apply"),
    ("track panda --self-motion damp --swing 0.1", "--swing 0.1 does not apply"),
    ("track panda --self-motion posture --v 0.1 0 0 0", "--v 0.1 0.0 0.0 0.0 does not apply"),
    ("track panda --self-motion energy --kp-self-motion 9", "--kp-self-motion 9.0 does not apply"),
    ("track panda --self-motion damp --kp-self-motion 9", "--kp-self-motion 9.0 does not apply"),
    ("track panda --self-motion free --kd-self-motion 9", "--kd-self-motion 9.0 does not apply"),
    ("track panda --stiffness 800", "--stiffness 800.0 does not apply: it belongs to --controller impedance"),
    ("track panda --self-motion-stiffness 9", "--self-motion-stiffness 9.0 does not apply"),
    ("track panda --damping-ratio 1", "--damping-ratio 1.0 does not apply"),
    ("rehearse panda --stiffness 800", "--stiffness 800.0 does not apply"),
    ("rehearse panda --self-motion-stiffness 9", "--self-motion-stiffness 9.0 does not apply"),
    ("rehearse panda --damping-ratio 1", "--damping-ratio 1.0 does not apply"),
    ("track panda --controller impedance --kp 50", "--kp 50.0 does not apply: other controllers have gains"),
    ("track panda --controller task-space --kp 50", "--kp 50.0 does not apply: other controllers have gains"),
    ("track panda --controller task-space --kd 50", "--kd 50.0 does not apply"),
    ("track panda --controller set-point --swing 0.1", "--swing 0.1 does not apply"),
    ("track panda --controller set-point --chart-margin 0.6", "--chart-margin 0.6 does not apply"),
    ("track panda --controller set-point --metric inertial", "--metric inertial does not apply"),
    ("track panda --controller set-point --self-motion damp", "--self-motion damp does not apply"),
    ("track panda --substeps 2", "--substeps 2 does not apply: it belongs to sampled runs"),
    ("track panda --control-rate 500 --push-time 1 2", "--push-time 1.0 2.0 does not apply: there is no push"),
    ("track panda --control-rate 500 --rtol 1e-6", "--rtol 1e-06 does not apply: it belongs to continuous runs"),
    ("track panda --control-rate 500 --method RK45", "--method RK45 does not apply"),
    ("track ur5 --command position --controller set-point", "--controller set-point does not apply: positions"),
    ("track ur5 --command velocity --noise 1e-3", "--noise 0.001 does not apply: positions and velocities go to"),
    ("track ur5 --command position --torque-limits", "--torque-limits True does not apply: positions"),
    ("track ur5 --command position --rtol 1e-6", "--rtol 1e-06 does not apply: positions"),
    ("track ur5 --command position --plant mujoco", "--plant mujoco does not apply: positions"),
    ("track ur5 --acceleration 3", "--acceleration 3.0 does not apply: torques are commanded"),
    ("track panda --further-path some.csv", "--further-path some.csv does not apply: there is no further task"),
    ("rehearse panda --further-path some.csv", "--further-path some.csv does not apply: there is no further task"),
    ("track panda --seed 3", "--seed 3 does not apply: nothing is random"),
    ("compare panda --control-rate 500 --seed 3", "--seed 3 does not apply"),
    ("track panda --task pose --axes xy", "axes 'xy' do not apply to a task of pose"),
    ("track panda --task orientation --axes xy", "axes 'xy' do not apply to a task of orientation"),
    ("track ppr --task heading --axes xy", "axes 'xy' do not apply to a task of heading"),
    ("info panda --csv a.csv", "--csv a.csv does not apply"),
    ("ik panda --to 0.4 0.1 0.5 --path a.csv", "--to and --path exclude each other"),
    ("robots --csv a.csv", "a list of robots cannot be drawn"),
    ("track ur5 --task pose --swing 0.1", "no self-motion to command: the task takes all joints (r = 0)"),
    ("track ur5 --task pose --self-motion posture", "no self-motion to command"),
    ("sweep panda --seeds 2", "--seeds 2 does not apply: nothing is random"),
    ("sweep panda --path hold --size 0.1,0.2", "--size 0.1 does not apply"),
    ("sweep panda --controller set-point --metric inertial", "--metric inertial does not apply"),
    ("sweep panda --controller set-point --kp 50", "--kp 50.0 does not apply"),
    ("sweep panda --controller set-point --kd 50", "--kd 50.0 does not apply"),
    ("sweep panda --controller set-point --swing 0.1", "--swing 0.1 does not apply"),
    ("sweep panda --controller set-point --self-motion damp", "--self-motion damp does not apply"),
    ("sweep panda --self-motion damp --kp-self-motion 9", "--kp-self-motion 9.0 does not apply"),
    ("sweep panda --self-motion free --kd-self-motion 9", "--kd-self-motion 9.0 does not apply"),
    ("sweep panda --controller set-point --chart-margin 0.6", "--chart-margin 0.6 does not apply"),
    ("sweep panda --path hold --period 5", "--period 5.0 does not apply"),
    ("sweep panda --cycles 5 --duration 9", "--cycles 5 does not apply"),
    ("sweep panda --task pose --axes xy", "axes 'xy' do not apply"),
    ("sweep panda --noise 1e-5", "those of a sampled run; add --control-rate 1000"),
    ("sweep panda --delay 0.01", "those of a sampled run"),
    ("sweep panda --torque-limits", "those of a sampled run"),
    *(
        (f"track panda --plan p.npz {more}", f"{more.split()[0]} {told} does not apply: --plan has a task")
        for more, told in (
            ("--task pose", "pose"),
            ("--axes xy", "xy"),
            ("--tool-axis x", "x"),
            ("--path circle", "circle"),
            ("--self-motion damp", "damp"),
        )
    ),
    ("track panda --tool-axis x", "a tool axis, 'x', does not apply to a task of position"),
    ("compare panda --tool-axis x", "a tool axis, 'x', does not apply"),
    ("plan panda --tool-axis x", "a tool axis, 'x', does not apply"),
    ("ik panda --tool-axis x", "a tool axis, 'x', does not apply"),
    ("info panda --tool-axis x", "a tool axis, 'x', does not apply"),
    ("selfmotion panda --tool-axis x", "a tool axis, 'x', does not apply"),
    ("selfmotion panda --task pose --axes xy", "axes 'xy' do not apply"),
    ("explore panda --tool-axis x", "a tool axis, 'x', does not apply"),
    ("explore panda --task pose --axes xy", "axes 'xy' do not apply"),
    ("compare panda --task pose --axes xy", "axes 'xy' do not apply"),
    ("plan panda --task pose --axes xy", "axes 'xy' do not apply"),
    ("ik panda --task pose --axes xy", "axes 'xy' do not apply"),
    ("info panda --task pose --axes xy", "axes 'xy' do not apply"),
    ("track ur5 --task pose --v 0.1", "no self-motion to command"),
    ("track ur5 --task pose --kp-self-motion 50", "no self-motion to command"),
    ("track ur5 --task pose --chart-margin 0.6", "no self-motion to command"),
    ("ik ur5 --task pose --v 0.1", "--v does not apply: the task takes all joints (r = 0)"),
    ("ik ur5 --task pose --metric inertial", "--metric inertial does not apply: the task takes all joints (r = 0)"),
    ("compare panda --controllers task-space --metric inertial", "--metric inertial does not apply"),
    *(
        (f"{command} panda {option}", "those of a sampled run; add --control-rate 1000")
        for command in ("track", "compare")
        for option in (
            "--noise 1e-5",
            "--delay 0.01",
            "--dropout 0.1",
            "--friction 1 1",
            "--push 1 0 0",
            "--torque-limits",
            "--torque-rate 9",
            "--soft-start 0.1",
        )
    ),
    *(
        (f"compare panda {option}", "does not apply")
        for option in (
            "--path hold --plane yz",
            "--path hold --period 5",
            "--substeps 2",
            "--control-rate 500 --push-time 1 2",
            "--control-rate 500 --rtol 1e-6",
            "--control-rate 500 --method RK45",
        )
    ),
    ("compare panda --controllers eos eos", "each controller is compared once"),
    *(
        (f"plan panda --path way.csv {option}", "does not apply: it belongs to the paths eight, circle and line")
        for option in ("--size 0.1", "--centre 0 0 0", "--plane yz", "--period 3")
    ),
    ("plan panda --timing fastest --period 3", "--period 3 does not apply: --timing fastest finds the time"),
    ("plan panda --corners round --blend 0.1", "--corners round does not apply: it belongs to way points"),
    ("plan panda --allow-winding", "allow_winding changes nothing here: it is for closed paths of robots"),
    ("plan panda --clearance 0.1", "--clearance 0.1 does not apply: there is nothing to be clear of"),
    ("plan panda --capsules c.json", "--capsules c.json does not apply"),
    ("plan panda --cost clearance", "needs a scene or self_collision"),
    ("replay run.npz --csv a.csv --robot panda", "--robot panda does not apply"),
    ("robots --html a.html", "a list of robots cannot be drawn"),
    ("robots --plot a.png", "a list of robots cannot be drawn"),
    ("robots --view", "a list of robots cannot be drawn"),
    ("robots --bag a.bag", "a list of robots cannot be drawn"),
    ("robots --rerun a.rrd", "a list of robots cannot be drawn"),
    *(
        (f"selfmotion panda --task pose {option}", "does not apply: nothing moves here")
        for option in ("--csv a.csv", "--bag a", "--rerun a.rrd", "--html a.html", "--view")
    ),
    ("selfmotion panda --plot a.png", "does not apply: the figure has the potential along a curve"),
    *(
        (f"rehearse panda {option}", told)
        for option, told in (
            ("--seed 3", "--seed 3 does not apply: nothing is random"),
            ("--command position --soft-start 0.5", "--soft-start and --torque-rate do not apply"),
            ("--command position --torque-rate 9", "--soft-start and --torque-rate do not apply"),
            ("--command position --controller task-space", "--controller task-space does not apply"),
            ("--acceleration 3", "--acceleration 3.0 does not apply: torques are commanded"),
            ("--path hold --size 0.1", "--size 0.1 does not apply"),
            ("--path hold --plane yz", "--plane yz does not apply"),
            ("--path hold --period 5", "--period 5.0 does not apply"),
            ("--path hold --corners round", "--corners round does not apply"),
            ("--path some.csv --blend 0.1", "--blend 0.1 does not apply"),
            ("--controller set-point --metric inertial", "--metric inertial does not apply"),
            ("--cycles 5 --duration 9", "--cycles 5 does not apply"),
            ("--self-motion damp --swing 0.1", "--swing 0.1 does not apply"),
            ("--self-motion damp --v 0.1 0 0 0", "--v 0.1 0.0 0.0 0.0 does not apply"),
            ("--self-motion damp --kp-self-motion 9", "--kp-self-motion 9.0 does not apply"),
            ("--self-motion free --kd-self-motion 9", "--kd-self-motion 9.0 does not apply"),
            ("--controller set-point --kp 50", "--kp 50.0 does not apply"),
            ("--controller set-point --kd 50", "--kd 50.0 does not apply"),
            ("--controller set-point --chart-margin 0.6", "--chart-margin 0.6 does not apply"),
            ("--task pose --axes xy", "axes 'xy' do not apply"),
            ("--tool-axis x", "a tool axis, 'x', does not apply"),
            ("--point 1 0 0", "a point of the world is for the tasks look-at and distance"),
            ("--tolerance rz=0.2", "leave out --tolerance here"),
        )
    ),
    *(
        (f"analyze log.csv --robot panda {option}", told)
        for option, told in (
            ("--q0 1", "--q0 does not apply: the log has the joints"),
            ("--view", "--view does not apply: the run is over"),
            ("--further axis", "--further and --further-path do not apply"),
            ("--further-path a.csv", "--further and --further-path do not apply"),
            ("--tolerance rz=0.2", "--tolerance does not apply: every coordinate of the task counts"),
            ("--task pose --axes xy", "axes 'xy' do not apply"),
            ("--tool-axis x", "a tool axis, 'x', does not apply"),
            ("--point 1 0 0", "a point of the world is for the tasks look-at and distance"),
            ("--topic /joint_states", "topic '/joint_states' does not apply: log.csv is no bag"),
        )
    ),
    *(
        (f"{command} panda --task position --combine elbow=1", "combinations of joints are for the task joints")
        for command in ("track", "compare", "plan", "info", "ik", "explore", "selfmotion", "rehearse")
    ),
    ("analyze log.csv --robot panda --combine elbow=1", "combinations of joints are for the task joints"),
    *(
        (f"{command} panda --task position --further axis --further-path some.csv", "leave out --further and")
        for command in ("compare", "plan", "info", "ik", "explore", "selfmotion")
    ),
    ("info panda --bag a.bag", "--bag a.bag does not apply"),
    ("info panda --rerun a.rrd", "--rerun a.rrd does not apply"),
]

#: Options that count in every combination, by command: what is asked for, and files that are written.
ROBOT, FILES = (
    "robot frame seen_from lock package_dirs gravity tool payload point tolerance",
    "out json html plot csv view bag rerun",
)
ALWAYS = {
    "track": f"{ROBOT} q0 further duration controller plant control_rate model_error {FILES} plan scene",
    "compare": f"{ROBOT} task q0 path duration plant control_rate model_error {FILES}",
    "plan": f"{ROBOT} task q0 path closed scene self_collision margin joint_step start reconfigurations effort timing "
    f"acceleration torque_limits {FILES} seed save",
    "sweep": "robot task path controller payload control_rate model_error frame gravity duration plant out table plot "
    "json jobs",
    "info": f"{ROBOT} task q0 out json html plot view",
    "ik": f"{ROBOT} task q0 {FILES}",
    "replay": f"runs {FILES}",
    "robots": "name out json",
    "demo": "robot html",
    "explore": f"{ROBOT} task q0 html",
    "selfmotion": f"{ROBOT} task q0 at out json plot seed",
    "rehearse": f"{ROBOT} q0 further task path duration controller command control_rate speed watchdog priority "
    "model_error self_motion log json",
    "analyze": f"log {ROBOT} task period joints degrees {FILES}",
}


def options_of(command):
    """Names of all options of a command."""
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        if dataclasses.is_dataclass(parameter.annotation):
            yield from (each.name for each in fields(parameter.annotation))
        else:
            yield parameter.name


@pytest.mark.parametrize("name", ALWAYS)
def test_every_option_counts_always_or_is_refused_somewhere(name):
    command = getattr(importlib.import_module(f"eos_pin.cli.{MODULES.get(name, name)}"), name)
    refused = {word[2:].replace("-", "_") for words, _ in REFUSED if words.startswith(name) for word in words.split()}
    left = set(options_of(command)) - set(ALWAYS[name].split()) - refused
    assert not left, f"no combination is tried in which {sorted(left)} of {name} do not apply"


def test_sweep_prints_the_notes_of_paths_and_tasks(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    task = make_task(load_robot("ur5", chain_to="auto"), "pose")
    x, y, z = task.value(rest_posture(task))[:3]
    Path("late.csv").write_text(f"t,x,y,z\n1.7e9,{x},{y},{z}\n1700000000.2,{x},{y},{z + 0.005}\n")
    assert main(["sweep", "ur5", "--task", "pose", "--path", "late.csv", "--jobs", "1", "--out", "kept"]) == 0
    told = " ".join(capsys.readouterr().err.split())
    assert "late.csv" in told
    assert "1.7e+09" in told or "1700000000" in told
    assert "(r = 0)" in told


@pytest.mark.parametrize(("words", "told"), REFUSED, ids=[words for words, _ in REFUSED])
def test_option_that_changes_nothing_is_refused(words: str, told: str, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words.split()) == 2
    assert told in " ".join(capsys.readouterr().err.split())
    assert not list(tmp_path.iterdir())


def test_rules_name_options_that_exist() -> None:
    kinds = (TaskOptions, PathOptions, ControlOptions, RunOptions)
    known = {each.name for kind in kinds for each in fields(kind)} | {"seed"}
    assert {name for rule in RULES for name in rule.names} <= known


@pytest.mark.parametrize("option", [{"size": 0.1}, {"plane": "yz"}, {"period": 3.0}])
def test_path_that_holds_still_takes_no_shape(panda, option) -> None:
    task = make_task(panda)
    with pytest.raises(InputError, match="holds still"):
        fitting_path(task, rest_posture(task), shape="hold", **option)


#: Arguments of Python that nothing would use, and the reason that is told.
UNUSED = {
    "speed=0.2 does not apply: there is no dry friction": lambda robot, task, q: Friction(1.0, speed=0.2),
    "seed=3 does not apply: no error is asked for": lambda robot, task, q: robot.perturbed(seed=3),
    "seed=3 does not apply: nothing is random": lambda robot, task, q: simulate_sampled(
        robot, EosController(task, task.hold(q)), q, duration=0.01, seed=3
    ),
    "first_torque=.* does not apply: there is no ramp": lambda robot, task, q: ControlLoop(
        EosController(task, task.hold(q)), first_torque=np.zeros(robot.n)
    ),
    "pull=0.3 does not apply: there is no posture": lambda robot, task, q: Avoidance(
        Clearance(robot, [Obstacle(coal.Sphere(0.1), [0.9, 0.0, 0.9])]), pull=0.3
    ),
    "points=3 does not apply: a search tells no motion": lambda robot, task, q: inverse_kinematics(
        task, task.value(q), q, strategies=["search"], points=3
    ),
    "v=.* does not apply: a search": lambda robot, task, q: inverse_kinematics(
        task, task.value(q), q, strategies=["search"], v=np.zeros(robot.n - task.m)
    ),
    "tries=3 does not apply: nothing is searched for": lambda robot, task, q: inverse_kinematics(
        task, task.value(q), q, strategies=["via"], tries=3
    ),
    "seed=3 does not apply: continuation alone": lambda robot, task, q: inverse_kinematics(
        task, task.value(q), q, strategies=["continuation"], seed=3
    ),
    "step=0.2 does not apply: more than one joint is redundant": lambda robot, task, q: self_motion_manifold(
        task, task.value(q), step=0.2
    ),
    "resolution=0.2 does not apply: one joint is redundant": lambda robot, task, q: self_motion_manifold(
        PoseTask(robot, "panda_hand_tcp"), PoseTask(robot, "panda_hand_tcp").value(q), resolution=0.2
    ),
}


@pytest.mark.parametrize("told", UNUSED)
def test_argument_that_changes_nothing_is_refused(panda, told: str) -> None:
    task = PositionTask(panda, "panda_hand_tcp")
    with pytest.raises(InputError, match=told):
        UNUSED[told](panda, task, rest_posture(task))


def test_law_of_self_motion_is_refused_where_the_task_takes_all_joints(ur5) -> None:
    task = make_task(ur5, "pose")
    hold = task.hold(rest_posture(task))
    for make in (
        lambda: EosController(task, hold, Damp()),
        lambda: LimitedEosController(task, hold, Damp()),
        lambda: KinematicLoop(task, hold, Damp(), control_period=1e-2),
    ):
        with pytest.raises(InputError, match=r"self_motion=Damp does not apply: the task takes all joints \(r = 0\)"):
            make()


def test_folders_of_meshes_are_refused_for_a_file_that_has_none_read(tmp_path: Path) -> None:
    file = tmp_path / "arm.xml"
    file.write_text("<mujoco/>")
    with pytest.raises(InputError, match=r"package_dirs=.* does not apply: meshes of an MJCF file are not read"):
        load_robot(file, package_dirs=[tmp_path])


def test_planar_pose_has_axes(ppr) -> None:
    assert make_task(ppr, "pose", axes="x").m == 2


def test_task_of_all_joints_is_reported(ur5) -> None:
    task = make_task(ur5, "pose")
    q = rest_posture(task)
    run = simulate(ur5, EosController(task, Hold(task.value(q), task.m)), q, duration=0.05)
    with console.capture() as capture:
        console.print(run_table(run.summary()))
    assert "(r = 0)" in capture.get()


# -- what users write themselves -------------------------------------------------------------------------------------


class Falling(Controller):
    """No torque."""

    def torque(self, t, q, dq, state):
        return 0.0 * q


class Aimless(Falling):
    def __init__(self, task):
        self.task = task


class Open(Falling):
    task = reference = None


def test_own_controller_without_task_or_reference_is_reported(panda) -> None:
    task = make_task(panda)
    q = rest_posture(task)
    runs = [simulate(panda, controller, q, duration=0.02) for controller in (Falling(), Aimless(task), Open())]
    assert [run.status for run in runs] == ["finished"] * 3
    assert "Falling has no attribute task and no reference" in runs[0].message
    assert "Aimless has no attribute reference" in runs[1].message
    assert runs[2].message == ""


class Height(Task, kind="height_of_a_frame"):
    """Height of a frame by what Pinocchio has computed."""

    def __init__(self, robot):
        self._frame = robot.frame_id("panda_hand_tcp")
        super().__init__(robot, ["z"], ["m"])

    def compute_point(self, data):
        return np.array(data.oMf[self._frame].translation[2:])

    def compute_jacobian(self, data):
        return self.frame_jacobian(data, self._frame)[2:3]

    def compute_drift(self, data):
        return self.frame_acceleration(data, self._frame).linear[2:]


@pytest.mark.parametrize("stacked", [False, True])
def test_task_of_ones_own_may_read_placements_of_frames(panda, stacked: bool) -> None:
    own = Height(panda)
    task = StackedTask([PositionTask(panda, "panda_hand_tcp", "xy"), own]) if stacked else own
    expected = PositionTask(panda, "panda_hand_tcp", "xyz" if stacked else "z")
    random = np.random.default_rng(1)
    for _ in range(3):
        q, dq = random.uniform(-1.0, 1.0, (2, panda.n))
        # Each in a new place, so that placements left by an earlier call do not pass.
        assert np.allclose(task.value(q), expected.value(q), atol=1e-12)
        assert np.allclose(task.linearize(-q)[0], expected.value(-q), atol=1e-12)
        assert np.allclose(task.at(0.5 * q, dq).z, expected.value(0.5 * q), atol=1e-12)


def test_packages_own_tasks_compute_only_the_frames_they_need(panda) -> None:
    assert not any(make_task(panda, kind)._needs_frames for kind in ("position", "pose", "orientation", "com"))


@pytest.mark.parametrize("source", [None, 7, 1.5, ["panda"], pin.Model()], ids=lambda source: type(source).__name__)
def test_robot_source_refuses_other_values(source) -> None:
    with pytest.raises(
        InputError, match=rf"name, path or text of a URDF, got {type(source).__name__}.*Robot\.from_pinocchio\(model\)"
    ):
        load_robot(source)


def test_open_file_is_no_source_of_a_robot(tmp_path: Path) -> None:
    with (tmp_path / "a.urdf").open("w") as file, pytest.raises(InputError, match="got TextIOWrapper"):
        load_robot(file)
