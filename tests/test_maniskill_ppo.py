"""The pusher's task in the joint's frame, and its PPO baseline."""

import importlib.util
import sys

import numpy as np
import pytest
from refusal import assert_refused
from test_maniskill import SLIDE, needs_maniskill

from export.maniskill.ppo import PpoSettings, PushTask, make_task, run, train

TURNED = (
    SLIDE.replace('<axis xyz="-1 0 0"/>', '<axis xyz="0 1 0"/>')
    .replace('lower="0" upper="0.15"', 'lower="-0.15" upper="0"')
    .replace('<origin xyz="-0.02 0 0"/>', '<origin xyz="0 -0.02 0"/>')
    .replace("0.2 0.18 0.08", "0.18 0.2 0.08")
)
"""The same slide turned by 90 degrees about z, its joint counted the other way."""


@pytest.fixture
def slides(tmp_path):
    paths = []
    for name, text in (("as_it_was", SLIDE), ("turned", TURNED)):
        (tmp_path / name).mkdir()
        paths.append(tmp_path / name / "slide.urdf")
        paths[-1].write_text(text)
    return paths


@needs_maniskill
def test_the_task_is_the_same_however_the_object_stands_and_counts(slides):
    """The ball is put at the same place in the joint's frame; then equal actions give equal observations."""
    task, seen = PushTask(friction=2.0), []
    for path in slides:
        env = make_task(path, task)
        env.reset(seed=0)
        plain, frame = env.unwrapped, env._frame()
        plain.agent.place(plain._tensor(plain.body.moving_centre() + frame @ np.array([-0.2, 0.0, 0.0])))
        rng, courses = np.random.default_rng(0), [env._observe()]
        for _ in range(25):
            courses.append(env.step(np.array([0.8, 0.1, 0.1]) * rng.uniform(0.5, 1, 3))[0])
        seen.append(np.array(courses))
        assert [effect.name for effect in plain.body.simulated.effects] == ["coulomb_friction"]
        env.close()
    assert seen[0][0, 0] == pytest.approx(0.8) and seen[0][-1, 0] < 0.7  # it was pushed
    np.testing.assert_allclose(seen[0], seen[1], atol=2e-2)


@needs_maniskill
@pytest.mark.skipif(importlib.util.find_spec("stable_baselines3") is None, reason="freeart21[ppo] is not installed")
def test_a_policy_is_trained_and_run(slides):
    settings, task = PpoSettings(steps=100, rollout=100), PushTask(episode_steps=20)
    policy = train(slides[0], task, settings)
    result = run(policy, slides[1], task, 2)
    assert 0 <= result.share <= 1 and 0 <= result.joint_error <= 1 and 1 <= result.steps <= 20


def test_without_stable_baselines_it_says_what_to_install(slides, monkeypatch):
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    assert_refused(r"freeart21\[ppo\]", train, slides[0], PushTask(), PpoSettings())
