"""Many ManiSkill environments in one process, against one environment on a CPU each.

All of it but CUDA runs without a GPU, in `maniskill_scenes`; with one, the last test runs on it.
"""

import importlib.util
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from refusal import assert_refused
from test_maniskill import FREE_MOVING, LID, OPEN

from export.maniskill.assets import find_asset
from freeart21.effects import EFFECTS
from freeart21.files.asset import write_effects

if importlib.util.find_spec("mani_skill") is None:
    pytest.skip("ManiSkill is not installed: freeart21[maniskill]", allow_module_level=True)
import gymnasium
import sapien
import torch
from mani_skill.utils.structs import Pose
from maniskill_scenes import gpu_scenes_on_cpu

from export.maniskill import _environments

KNOB = """<link name="knob"><inertial><mass value="0.05"/>
    <inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="0.02 0.02 0.02"/></geometry></collision></link>
  <joint name="screw" type="fixed"><parent link="lid"/><child link="knob"/><origin xyz="0.18 0 0.02"/></joint>
</robot>"""
FRICTION, BOUNCE = EFFECTS["coulomb_friction"](0.02), EFFECTS["end_stop_bounce"](0.5, 0.1)
EFFECTS_OF = {
    "chest": (FRICTION, EFFECTS["viscous_damping"](0.02), BOUNCE, EFFECTS["time_offset"](0.03)),
    "knobbed": (EFFECTS["stribeck_friction"](0.01, 0.02, 0.2), EFFECTS["backlash"](0.05, 0.01, 0.0), BOUNCE),
    "stiff": (EFFECTS["return_spring"](60.0, 0.3), EFFECTS["presliding_friction"](0.02, 0.01), BOUNCE),
}


@pytest.fixture
def two(assets):
    return assets[:2]


@pytest.fixture
def assets(tmp_path):
    """Folders of two assets with different links, spans and effects, and of one that needs substeps."""
    rubbing = LID.replace('"0.01" friction', '"0.02" friction')
    still = LID.replace('"0.01" friction="0.02"', '"0" friction="0"')
    knobbed = still.replace("</robot>", KNOB).replace('upper="1.5"', 'upper="0.9"')
    texts = {"chest": rubbing, "knobbed": knobbed, "stiff": still}
    for name, text in texts.items():
        folder = tmp_path / name
        folder.mkdir()
        (folder / f"{name}.urdf").write_text(text)
        write_effects(folder, replace(find_asset(folder), effects={"hinge": EFFECTS_OF[name]}))
    return [str(tmp_path / name) for name in texts]


def make(env, assets, n=None, **settings):
    """An environment: n at once in GPU scenes, or one on a CPU."""
    where = {"sim_backend": "cpu"} if n is None else {"sim_backend": "physx_cuda", "num_envs": n}
    settings = {"obs_mode": "state", "reward_mode": "dense", "render_backend": "none"} | settings
    return gymnasium.make(env, asset=assets, **where, **settings)


def numbers(result):
    """(n, k) what a step gave: observations, rewards, the joint's error and whether it ended."""
    obs, reward, ended, _, info = result
    return np.column_stack(
        [*np.asarray(obs.cpu()).T, *(x.cpu().numpy().reshape(-1) for x in (reward, ended, info["joint_error"]))]
    )


def alone(env, asset, seed, actions, several=False, **settings):
    """(steps, k) as of `numbers`, of one environment on a CPU; a motor's positions become rad or m."""
    one = make(env, asset, **settings)
    one.reset(seed=seed)
    course = []
    for action in actions:
        if several:
            low, high = one.unwrapped.body.spans[0]
            action = np.concatenate([[0.5 * (low + high) + 0.5 * (high - low) * action[0]], action[1:]])
        course.append(numbers(one.step(np.asarray(action, np.float32)))[0])
    one.close()
    return np.array(course)


CASES = {  # n, settings, tolerance in any number of `numbers`
    "released": (64, OPEN, {"robot_uids": "none", "control_mode": "passive", "start": 0.6}, 2e-5),
    "one": (1, OPEN, {"robot_uids": "none", "control_mode": "passive", "start": 0.6}, 2e-5),
    "motor": (3, OPEN, {"robot_uids": "none", "start": 0.3}, 2e-5),
    "steps": (2, OPEN, {"robot_uids": "none", "control_mode": "pd_joint_delta_pos", "start": 0.3}, 2e-5),
    "stiff": (2, OPEN, {"robot_uids": "none", "control_mode": "passive", "start": 0.6}, 2e-3),
    # without it ManiSkill draws the places of all robots from the first environment's numbers
    "panda": (2, OPEN, {"start": 0.6, "control_mode": "pd_joint_delta_pos", "enhanced_determinism": True}, 2e-4),
    "free": (2, OPEN, {"robot_uids": "none", "control_mode": "passive", "base": "free", "start": 0.6}, 2e-3),
    "carried": (2, FREE_MOVING, {}, 2e-4),
    "led": (2, FREE_MOVING, {"control_mode": "pd_joint_pos_base_delta_pose"}, 2e-4),
}


@pytest.mark.parametrize("case", CASES)
def test_many_environments_go_as_each_alone(assets, monkeypatch, case):
    """Random actions and seeds, two assets in turn: observations, rewards and ends of the first, second and last."""
    n, uid, settings, tolerance = CASES[case]
    used = assets[2:] if case == "stiff" else assets[: min(n, 2)]
    normalised = settings.get("control_mode", "pd_joint_pos").startswith("pd_joint_pos") and len(used) > 1
    steps, rng = 10, np.random.default_rng(5)
    seeds = [11 + i for i in range(n)]
    with gpu_scenes_on_cpu(monkeypatch):
        many = make(uid, used, n, **settings)
        many.reset(seed=seeds)
        actions = rng.uniform(-1, 1, (steps, n, *many.unwrapped.single_action_space.shape)).astype(np.float32)
        results = [many.step(action) for action in actions]
        if len(used) > 1:
            assert results[-1][-1]["asset_index"].tolist() == [i % 2 for i in range(n)]
        course = np.array([numbers(result) for result in results])
        assert course.shape[:2] == (steps, n)
        many.close()
    for i in sorted({0, min(1, n - 1), n - 1}):
        true = alone(uid, used[i % len(used)], seeds[i], actions[:, i], several=normalised, **settings)
        moved = np.ptp(true[:, 0])
        assert moved > 0.01, "nothing moves: the test says nothing"
        np.testing.assert_allclose(course[:, i], true, rtol=1e-4, atol=tolerance)


@pytest.mark.parametrize("uid, settings", [(OPEN, {"robot_uids": "none"}), (FREE_MOVING, {})])
def test_some_begin_anew_and_the_others_go_on(two, monkeypatch, uid, settings):
    """After a reset of some they go as a new environment of their seeds, and the others as without it."""
    settings = {"control_mode": "pd_joint_delta_pos"} | settings
    actions = np.random.default_rng(2).uniform(-1, 1, (10, 4, 1)).astype(np.float32)
    rows = torch.tensor([1, 2])
    courses, seeds = [], []
    with gpu_scenes_on_cpu(monkeypatch):
        for partly in (False, True):
            many = make(uid, two, 4, enhanced_determinism=True, **settings)  # else no seed is drawn for a reset
            many.reset(seed=[1, 2, 3, 4])
            course = []
            for k, action in enumerate(actions):
                if partly and k == 5:
                    first, _ = many.reset(options={"env_idx": rows})
                    seeds = many.unwrapped._episode_seed
                    states = many.unwrapped.get_state_dict()["articulations"]["object"][rows]
                    assert not states[:, [*range(7, 13), 14]].any()  # velocities
                    assert many.unwrapped.elapsed_steps.tolist() == [5, 0, 0, 5]
                course.append(numbers(many.step(action)))
            courses.append(np.array(course))
            many.close()
    whole, partly = courses
    np.testing.assert_allclose(partly[:, [0, 3]], whole[:, [0, 3]], atol=1e-6)
    for i in rows.tolist():
        assert np.abs(partly[5:, i] - whole[5:, i]).max() > 0.01
        true = alone(uid, two[i % 2], int(seeds[i]), actions[5:, i], **settings)
        np.testing.assert_allclose(partly[5:, i], true, atol=1e-4)
        one = make(uid, two[i % 2], **settings)
        np.testing.assert_allclose(first[i], one.reset(seed=int(seeds[i]))[0][0], atol=1e-6)  # a late sensor's, too
        one.close()


def test_states_of_some_are_set_and_the_others_stay(two, monkeypatch):
    with gpu_scenes_on_cpu(monkeypatch):
        many = make(FREE_MOVING, two, 3, control_mode="passive")
        plain = many.unwrapped
        many.reset(seed=[1, 2, 3])
        before = plain.get_state_dict()
        for _ in range(4):
            many.step(np.zeros((3, 0), np.float32))
        after = plain.get_state_dict()
        rows = torch.tensor([2, 0])
        plain.set_state_dict({"articulations": {"object": before["articulations"]["object"][[0, 2]]}}, rows.sort()[0])
        now = plain.get_state_dict()["articulations"]["object"]
        for i, true in enumerate((before, after, before)):
            np.testing.assert_allclose(now[i], true["articulations"]["object"][i], atol=1e-6)
        np.testing.assert_allclose(plain.body.states()[0], now[:, 13], atol=1e-7)
        assert plain.body.times_s() == pytest.approx(0.2)  # the hand goes on
        many.close()


class Loaded(_environments.OpenEnvironment):
    """A ball of 1 kg lies on the lid."""

    def _load_scene(self, options):
        super()._load_scene(options)
        builder = self.scene.create_actor_builder()
        builder.add_sphere_collision(radius=0.02, density=30_000)
        builder.initial_pose = sapien.Pose([0, 0, 1])
        self.ball = builder.build("ball")

    def _initialize_episode(self, env_idx, options):
        super()._initialize_episode(env_idx, options)
        self.ball.set_pose(Pose.create_from_pq(self.body.centres() + torch.tensor([[0.0, 0.0, 0.0255]])))


def press(asset, n):
    """(8, n, 3) m: where balls are that lie on shut lids, one a control step."""
    where = {"sim_backend": "cpu"} if n is None else {"sim_backend": "physx_cuda", "num_envs": n}
    settings = {"obs_mode": "state", "render_backend": "none", "robot_uids": "none", "control_mode": "passive"}
    env = Loaded(asset=asset, start=0.0, **where, **settings)
    env.reset(seed=[3] * (n or 1))
    places = [env.ball.pose.p.numpy().copy() for _ in range(8) if env.step(np.zeros((n or 1, 0), np.float32))]
    env.close()
    return np.array(places)


def test_what_lies_on_a_joint_at_its_limit_is_held(tmp_path, monkeypatch):
    """Balls of 1 kg stay on lids that rest at their limits: the engine's limits hold them."""
    (tmp_path / "chest.urdf").write_text(LID)
    true = press(str(tmp_path / "chest.urdf"), None)
    with gpu_scenes_on_cpu(monkeypatch):
        course = press(str(tmp_path / "chest.urdf"), 2)
    assert np.ptp(true[:, 0, 2]) < 1e-3
    np.testing.assert_allclose(course, np.repeat(true, 2, axis=1), atol=1e-4)


def test_scenes_side_by_side_need_room(two, monkeypatch):
    with gpu_scenes_on_cpu(monkeypatch):
        near = {"sim_config": {"spacing": 0.3}}
        assert_refused("spacing of 0.3 m is too little", make, OPEN, two, 2, robot_uids="none", **near)


def go_on_a_gpu(uid, assets, settings, actions, rows):
    """(steps, 64, k) as of `numbers`, where the environments `rows` begin anew half-way, and their seeds then."""
    many = make(uid, assets, 64, enhanced_determinism=True, **settings)
    many.reset(seed=list(range(64)))
    course, half = [], len(actions) // 2
    for k, action in enumerate(actions):
        if k == half:
            many.reset(options={"env_idx": torch.tensor(rows, device="cuda")})
        course.append(numbers(many.step(action)))
    return np.array(course), [int(many.unwrapped._episode_seed[i]) for i in rows]


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
@pytest.mark.parametrize("uid, settings", [(OPEN, {"robot_uids": "none", "start": 0.6}), (FREE_MOVING, {})])
def test_on_a_gpu_many_go_as_each_alone(two, uid, settings):
    """In a new process: SAPIEN takes a GPU only before it has made a scene."""
    settings = {"control_mode": "pd_joint_delta_pos"} | settings
    actions = np.random.default_rng(5).uniform(-1, 1, (12, 64, 1)).astype(np.float32)
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as other:
        course, seeds = other.submit(go_on_a_gpu, uid, two, settings, actions, [1, 2]).result()
    for i in (0, 63):
        true = alone(uid, two[i % 2], i, actions[:, i], **settings)
        np.testing.assert_allclose(course[:, i], true, atol=0.02)
    for i, seed in zip((1, 2), seeds, strict=True):
        true = alone(uid, two[i % 2], seed, actions[6:, i], **settings)
        np.testing.assert_allclose(course[6:, i], true, atol=0.02)
