"""The environment for learning: gymnasium's own checks, exact tasks whatever the actions, and limits."""

from __future__ import annotations

import numpy as np
import pytest

from eos_pin import InputError, PoseTask, PositionTask, circle, load_robot

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402

from eos_pin.experiments.environment import SelfMotionEnv  # noqa: E402

Q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.0, 2.0])


@pytest.fixture(scope="module")
def task():
    return PositionTask(load_robot("panda", chain_to="panda_hand_tcp"), "panda_hand_tcp")


@pytest.fixture
def along(task):
    return SelfMotionEnv(task, circle(task.value(Q), 0.1, period=4.0, plane="yz"), q0=Q, control_period=0.1)


@pytest.mark.parametrize("actions", ["rates", "set-points"])
def test_environment_passes_the_checks_of_gymnasium(task, actions):
    check_env(SelfMotionEnv(task, actions=actions, control_period=0.1, duration=0.5), skip_render_check=True)


def test_environment_along_a_path_passes_the_checks_of_gymnasium(along):
    check_env(along, skip_render_check=True)
    assert along.action_space.shape == (4,)


def test_environment_keeps_path_and_limits_at_any_action(along, task):
    along.reset(seed=3)
    along.action_space.seed(3)
    robot, over = task.robot, False
    while not over:
        _, reward, ended, late, _ = along.step(along.action_space.sample())
        over = ended or late
        np.testing.assert_allclose(task.value(along.q), along.path(along.t).z, atol=1e-9)
        assert (along.q >= robot.lower).all()
        assert (along.q <= robot.upper).all()
        assert np.isfinite(reward)


def test_environment_refuses_actions_beyond_joint_limits(task):
    env = SelfMotionEnv(task, q0=Q, control_period=0.1, duration=60.0, self_motion_rate=2.0)
    env.reset(seed=0)
    # Always the same way: some joint comes to its limit.
    blocked = [env.step([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])[4]["blocked"] for _ in range(100)]
    assert blocked[-1]
    q = env.q
    assert ((q >= task.robot.lower) & (q <= task.robot.upper)).all()


def test_rates_move_task_and_self_motion_by_their_integral(task):
    env = SelfMotionEnv(task, q0=Q, control_period=0.1, task_rate=0.2, self_motion_rate=0.5)
    env.reset(seed=0)
    z, v, chart = env.z, env.v, env.chart
    env.step([1.0, 0.0, -0.5, 0.0, 1.0, 0.0, 0.0])
    np.testing.assert_allclose(env.z - z, [0.02, 0.0, -0.01], atol=1e-9)
    assert env.chart is chart
    np.testing.assert_allclose(env.v - v, [0.0, 0.05, 0.0, 0.0], atol=1e-9)


def test_environment_repeats_an_episode_with_the_same_seed(task):
    env, seen = SelfMotionEnv(task, control_period=0.1), []
    for _ in range(2):
        env.reset(seed=5)
        seen.append([env.step(np.full(7, 0.3))[0] for _ in range(5)])
    np.testing.assert_array_equal(*seen)


@pytest.mark.slow
def test_environments_run_in_processes_side_by_side(task):
    with_path = {"task": task, "path": circle(task.value(Q), 0.1, period=4.0, plane="yz"), "q0": Q}
    envs = gymnasium.make_vec(
        "eos_pin/SelfMotion-v0", num_envs=2, vectorization_mode="async", max_episode_steps=50, **with_path
    )
    seen, _ = envs.reset(seed=1)
    assert seen.shape == (2, 12)
    seen, rewards, *_ = envs.step(np.zeros((2, 4), np.float32))
    assert rewards[0] == rewards[1]
    envs.close()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"actions": "torques"}, "'rates' or 'set-points'"),
        ({"duration": 0.0}, "above 0"),
        ({"q0": [0.0]}, "q0"),
        ({"task_rate": -1.0}, "task_rate"),
    ],
)
def test_environment_refuses_settings(task, options, told):
    with pytest.raises(InputError, match=told):
        SelfMotionEnv(task, **options)


def test_environment_refuses_a_path_without_self_motion_and_wrong_actions(task):
    arm = load_robot("ur5", chain_to="tool0")
    pose = PoseTask(arm, "tool0")
    with pytest.raises(InputError, match="nothing left to learn"):
        SelfMotionEnv(pose, pose.hold(np.array([0.0, -1.2, 1.8, 0.0, -1.5, 0.0])))
    env = SelfMotionEnv(task)
    with pytest.raises(InputError, match="action"):
        env.step([0.0, 1.0])
    with pytest.raises(InputError, match="option"):
        env.reset(options={"posture": Q})
