"""ManiSkill environments: the same physics as `generator.simulate`, ManiSkill's own shapes, files there and back.

What needs ManiSkill, an extra, is skipped without it.
"""

import importlib.util
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from refusal import assert_refused

from export.maniskill import ENVIRONMENTS
from export.maniskill.assets import find_asset, prepare_asset
from export.maniskill.motion import draw_motion
from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files.asset import write_effects
from freeart21.files.urdf import read_urdf_joints
from generator.simulate import load, roll_out

ROOT = Path(__file__).resolve().parents[1]
OPEN, FREE_MOVING = ENVIRONMENTS
needs_maniskill = pytest.mark.skipif(
    importlib.util.find_spec("mani_skill") is None, reason="ManiSkill is not installed: freeart21[maniskill]"
)

LID = """<robot name="chest">
  <link name="chest"><inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>
    </inertial><collision><geometry><box size="0.2 0.2 0.1"/></geometry></collision>
    <visual><geometry><box size="0.2 0.2 0.1"/></geometry></visual></link>
  <link name="lid"><inertial><origin xyz="0.1 0 0.005"/><mass value="0.2"/>
    <inertia ixx="7e-4" iyy="7e-4" izz="1.3e-3" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0.1 0 0.005"/><geometry><box size="0.2 0.2 0.01"/></geometry></collision>
    <visual><origin xyz="0.1 0 0.005"/><geometry><box size="0.2 0.2 0.01"/></geometry></visual></link>
  <joint name="hinge" type="revolute"><parent link="chest"/><child link="lid"/><origin xyz="-0.1 0 0.05"/>
    <axis xyz="0 -1 0"/><limit lower="0" upper="1.5" effort="1" velocity="1"/>
    <dynamics damping="0.01" friction="0.02"/></joint>
</robot>"""


@pytest.fixture
def chest(tmp_path: Path) -> Path:
    (tmp_path / "chest").mkdir()
    (tmp_path / "chest" / "chest.urdf").write_text(LID)
    return tmp_path / "chest"


def make(env: str, asset: Path, **settings):
    import gymnasium

    settings = {"obs_mode": "state", "sim_backend": "cpu", "render_backend": "none"} | settings
    return gymnasium.make(env, asset=str(asset), **settings)


# --- without ManiSkill ------------------------------------------------------------------------------------------------


def test_without_maniskill_it_says_what_to_install(monkeypatch):
    gymnasium = pytest.importorskip("gymnasium")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert_refused("maniskill", gymnasium.make, OPEN)


def test_gymnasium_finds_them_without_an_import(tmp_path):
    """In a new interpreter, by "module:name"; ManiSkill is not imported."""
    pytest.importorskip("gymnasium")
    code = f"""
import sys; sys.path[:0] = [{str(ROOT)!r}]
import gymnasium
try:
    gymnasium.make("export.maniskill:{OPEN}", asset="no such object")
except Exception as error:
    print(gymnasium.spec("{OPEN}").max_episode_steps, "mani_skill" in sys.modules, error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    has_it = importlib.util.find_spec("mani_skill") is not None
    assert done.stdout.startswith(f"200 {has_it} "), done.stderr
    assert ("no such object" if has_it else "freeart21[maniskill]") in done.stdout


def test_what_is_no_object_is_reported(tmp_path):
    assert_refused("neither a file or folder nor an object of the catalog", find_asset, "no_such_thing")
    assert_refused("found URDFs: none", find_asset, tmp_path)


def test_an_object_at_another_scale_has_its_lengths_masses_and_swing(chest):
    free = chest / "chest.urdf"
    free.write_text(LID.replace('<dynamics damping="0.01" friction="0.02"/>', ""))
    with prepare_asset(find_asset(chest), 4.0) as large:
        joint = read_urdf_joints(large.urdf)["hinge"]
        np.testing.assert_allclose(joint.T_parent_joint[:3, 3], [-0.4, 0, 0.2])
        big, small = load(large), load(find_asset(chest))
        assert big.moving_mass == pytest.approx(64 * small.moving_mass, rel=1e-5)
        assert big.joint_inertia == pytest.approx(1024 * small.joint_inertia, rel=1e-4)
        # a pendulum's time goes with the root of its length
        slow, fast = roll_out(big, 1.2, duration_s=0.3).q, roll_out(small, 1.2, duration_s=0.15).q
    np.testing.assert_allclose(slow[::2], fast, atol=2e-3)


def test_effects_hold_for_one_size_only(chest):
    with pytest.raises(FreeArtError, match="expected scale 1"), prepare_asset(find_asset(chest), 2.0):
        pass


def test_a_drawn_motion_begins_where_it_is_asked_and_its_speed_is_its_slope():
    start = se3.exp_se3(np.array([0.1, 0, 0.2, 0.3, 0, 0]))
    motion = draw_motion(np.random.RandomState(1), start, [0, 0, 0.1], 0.2, 5.0)
    np.testing.assert_allclose(motion.at(0.0)[0], start)
    t, h = 2.2, 1e-5
    pose, linear, angular = motion.at(t)
    before, after = motion.at(t - h)[0], motion.at(t + h)[0]
    np.testing.assert_allclose(linear, (after - before)[:3, 3] / (2 * h), atol=1e-6)
    turn = (after - before)[:3, :3] / (2 * h) @ pose[:3, :3].T
    np.testing.assert_allclose(angular, [turn[2, 1], turn[0, 2], turn[1, 0]], atol=1e-6)
    assert np.linalg.norm(angular) > 0.01 and not motion.at(100.0)[1].any()
    again = draw_motion(np.random.RandomState(1), start, [0, 0, 0.1], 0.2, 5.0)
    np.testing.assert_array_equal(motion.poses, again.poses)


# --- with ManiSkill ---------------------------------------------------------------------------------------------------


@needs_maniskill
@pytest.mark.parametrize("base", ["fixed", "free"])
def test_a_released_lid_falls_as_in_roll_out(chest, base):
    """Damping and Coulomb friction act. A heavy free chest on the ground stays where it is; the lid falls the same."""
    if base == "free":
        text = LID.replace('<mass value="1"/>', '<mass value="100"/>').replace("0.01", "1", 3)
        (chest / "chest.urdf").write_text(text)
    env = make(OPEN, chest, robot_uids="none", control_mode="passive", start=0.8, base=base)
    env.reset(seed=0)
    body = env.unwrapped.body
    course = [body.q]
    for _ in range(12):
        env.step(np.zeros(0, np.float32))
        course.append(body.q)
    env.close()
    true = roll_out(find_asset(chest), course[0], duration_s=0.6).q[::50]
    assert course[0] == pytest.approx(1.2) and true[-1] < 0.2
    falling = true > 0.05
    np.testing.assert_allclose(np.array(course)[falling], true[falling], atol=0.01 * 1.5)


@needs_maniskill
@pytest.mark.parametrize(
    "env, settings", [(OPEN, {"robot_uids": "none"}), (OPEN, {"robot_uids": "panda"}), (FREE_MOVING, {})]
)
def test_it_passes_gymnasiums_checker_and_is_the_same_from_a_seed(chest, env, settings):
    from gymnasium.utils.env_checker import check_env
    from mani_skill.utils.wrappers.gymnasium import CPUGymWrapper

    made = CPUGymWrapper(make(env, chest, reward_mode="dense", **settings).unwrapped)
    made.unwrapped.spec = None  # by which ManiSkill's environments cannot be made again
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(made, skip_render_check=True)
    lines = {str(warning.message) for warning in caught if "WARN" in str(warning.message)}
    of_spaces = ("unwrapped version", "space minimum value is -inf", "space maximum value is inf", "normalized space")
    assert not [line for line in lines if not any(text in line for text in of_spaces)]
    courses = []
    for _ in range(2):
        made.reset(seed=5)
        made.action_space.seed(1)
        courses.append([made.step(made.action_space.sample())[0] for _ in range(10)])
    np.testing.assert_array_equal(*courses)
    made.close()
    made.close()


@needs_maniskill
def test_an_episode_ends_at_its_limit(chest):
    import gymnasium

    assert gymnasium.spec(OPEN).max_episode_steps == 200
    short = make(OPEN, chest, robot_uids="none", control_mode="passive", max_episode_steps=3)
    short.reset(seed=0)
    ended = [short.step(np.zeros(0, np.float32))[3] for _ in range(3)]
    assert [bool(end) for end in ended] == [False, False, True] and ended[0].shape == (1,)


@needs_maniskill
def test_the_motor_brings_the_lid_to_its_target_and_is_paid(chest):
    env = make(FREE_MOVING, chest, reward_mode="sparse", start=0.0, target=0.6)
    env.reset(seed=1)
    rewards = [env.step(np.array([0.9], np.float32))[1].item() for _ in range(30)]
    assert rewards[0] == 0 and rewards[-1] == 1
    assert env.unwrapped.body.q == pytest.approx(0.9, abs=0.02 * 1.5)
    away = (
        env.unwrapped.hand._motions[0].at(env.unwrapped.body.simulated.time_s)[0] - env.unwrapped.body.root_poses()[0]
    )
    assert np.abs(away[:3, 3]).max() < 2e-3  # the hand carries it along
    env.close()


@needs_maniskill
@pytest.mark.parametrize("fault", ["limit", "fell", "no number"])
def test_it_fails_where_nothing_can_be_had_any_more(chest, fault):
    """Past a limit by more than the tolerance, below the ground, or without a number: the episode ends, at a loss."""
    env = make(OPEN, chest, robot_uids="none", control_mode="passive", base="free", start=0.5, reward_mode="sparse")
    env.reset(seed=0)
    body, plain = env.unwrapped.body, env.unwrapped
    fail = plain.evaluate()["fail"]
    assert str(fail.dtype) == "torch.bool" and fail.shape == (1,) and not fail.any()
    upper, span = body.spans[0, 1], np.ptp(body.spans[0])
    body.put(upper + 0.5 * plain._tolerance * span)
    assert not plain.evaluate()["fail"].any()
    if fault == "limit":
        body.put(upper + 1.5 * plain._tolerance * span)
    elif fault == "fell":
        body.put(0.5, se3.exp_se3(np.array([0, 0, -0.3, 0, 0, 0])))
    else:
        body.simulated._q = np.nan
    info = plain.evaluate()
    assert info["fail"].all() and not info["success"].any()
    assert plain.compute_sparse_reward(None, None, info) == -1 and plain.compute_dense_reward(None, None, info) == 0
    env.close()


@needs_maniskill
def test_pictures_have_maniskills_shapes_and_name_the_parts(chest):
    env = make(OPEN, chest, robot_uids="none", obs_mode="rgb+depth+segmentation", render_backend="cpu")
    obs, _ = env.reset(seed=0)
    seen = obs["sensor_data"]["base_camera"]
    kinds = {name: (tuple(value.shape), str(value.dtype)) for name, value in seen.items()}
    assert kinds == {
        "rgb": ((1, 128, 128, 3), "torch.uint8"),
        "depth": ((1, 128, 128, 1), "torch.int16"),
        "segmentation": ((1, 128, 128, 1), "torch.int16"),
    }
    ids = dict(obs["extra"]["part_ids"][0].tolist())
    assert sorted(ids.values()) == [1, 2] and set(ids) <= set(np.unique(seen["segmentation"]))
    names = {side: env.unwrapped.segmentation_id_map[k].name for k, side in ids.items()}
    assert names == {1: "chest", 2: "lid"}
    env.close()


@needs_maniskill
def test_the_asset_s_own_effects_json_acts(chest):
    """The same lid with ten times the friction in effects.json stays where it is let go."""
    from dataclasses import replace

    from freeart21.effects.coulomb_friction import CoulombFriction

    (chest / "chest.urdf").write_text(LID.replace('damping="0.01" friction="0.02"', 'damping="0" friction="0.3"'))
    asset = find_asset(chest)
    write_effects(chest, replace(asset, effects={"hinge": (CoulombFriction(0.3),)}))
    env = make(OPEN, chest, robot_uids="none", control_mode="passive", start=0.5)
    env.reset(seed=0)
    for _ in range(10):
        env.step(np.zeros(0, np.float32))
    assert env.unwrapped.body.q == pytest.approx(0.75, abs=1e-4)
    env.close()


@needs_maniskill
def test_it_warns_of_effects_that_do_not_show(chest, monkeypatch):
    from dataclasses import replace

    from export.maniskill import _body
    from freeart21.effects.axis_tilt import AxisTilt

    tilt = AxisTilt(*[0.01] * len(AxisTilt.parameters()))
    (chest / "chest.urdf").write_text(LID.replace('damping="0.01" friction="0.02"', 'damping="0" friction="0"'))
    write_effects(chest, replace(find_asset(chest), effects={"hinge": (tilt,)}))
    lines = []
    monkeypatch.setattr(_body.logger, "warning", lines.append)
    make(OPEN, chest, robot_uids="none").close()
    assert any("axis_tilt" in line for line in lines)


@needs_maniskill
def test_of_several_objects_each_reset_has_one(chest):
    """Drawn from the seed; what is observed and done keeps its shape, actions are within -1 and 1."""
    import gymnasium

    (chest / "small.urdf").write_text(LID.replace('upper="1.5"', 'upper="0.5"'))
    both = [str(chest / name) for name in ("chest.urdf", "small.urdf")]
    settings = {"obs_mode": "state", "sim_backend": "cpu", "render_backend": "none"}
    env = gymnasium.make(OPEN, asset=both, robot_uids="none", target=0.4, **settings)
    assert env.unwrapped.single_action_space == gymnasium.spaces.Box(-1, 1, (1,), np.float32)
    seen = {}
    for seed in (1, 2, 3, 4, 5, 1):
        obs, _ = env.reset(seed=seed)
        info = env.unwrapped.evaluate()
        assert {tuple(value.shape) for value in info.values()} == {(1,)} and not info["fail"].any()
        assert env.observation_space.shape == obs.shape
        index = int(info["asset_index"])
        assert seen.setdefault(seed, index) == index
        assert float(env.unwrapped._target) == pytest.approx(0.4 * (1.5, 0.5)[index], abs=1e-6)
    assert {*seen.values()} == {0, 1}
    assert_refused("empty list", gymnasium.make, OPEN, asset=[])
    env.close()
