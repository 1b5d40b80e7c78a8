"""From recordings of a released joint to a measured set: frames, gravity, masses, tracker errors."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from synthetic_case import truth_as_answer
from test_track import URDF

from freeart21 import se3
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset
from freeart21.files.measured import read_measured
from freeart21.files.result import write_result
from freeart21.files.truth import read_truth
from generator.measure import TrackerNoise, measure_truths
from generator.recorder import RecordSettings, record
from generator.simulate import joint_motion, load, roll_out
from simgap.geometry.kinematics import find_geometry
from simgap.geometry.placing import place
from simgap.measure.reconstruction import measure_result

OIL = ViscousDamping(1.5e-4)


def effects_file(folder: Path, *effects, joint: str = "joint_1") -> Path:
    path = folder / "effects.json"
    listed = [effect.to_json("revolute") for effect in effects]
    path.write_text(json.dumps({"schema": "freeart21/effects/1", "joints": {joint: listed}}))
    return path


def settings(folder: Path, *effects, **more) -> RecordSettings:
    return RecordSettings(
        frames=45, seed=more.pop("seed", 3), width=64, height=36, queries=0, motion="release", shader="trivial",
        visible_every=20, edge=0.5,
        effects=effects_file(folder, *effects, joint=more.pop("effects_joint", "joint_1")), **more,
    )  # fmt: skip


@pytest.fixture(scope="module")
def film(tmp_path_factory) -> Path:
    """Ground truth of a stapler with a damped hinge, its arm released at 0.9 of its range."""
    folder = tmp_path_factory.mktemp("film")
    name = record("stapler", folder / "data", settings(folder, OIL, let_go=0.9))
    return folder / "data/truth" / name


@pytest.fixture(scope="module")
def lid_film(tmp_path_factory) -> Path:
    """Ground truth of a stapler whose moving part is the larger one, and so the reference."""
    folder = tmp_path_factory.mktemp("lid")
    name = record("stapler", folder / "data", settings(folder, OIL, let_go=0.9, seed=83))
    assert "link_1" in read_truth(folder / "data/truth" / name).source["reference_links"]
    return folder / "data/truth" / name


@pytest.mark.parametrize("of", ["film", "lid_film"])
def test_a_measured_set_reproduces_the_film(tmp_path: Path, of: str, request):
    film = request.getfixturevalue(of)
    truth = read_truth(film)
    measure_truths([film, film], tmp_path / "out", TrackerNoise(seed=1))
    asset, measured = read_asset(tmp_path / "out/asset"), read_measured(tmp_path / "out/measured")
    assert measured.joint == asset.joint == "joint_1" and asset.effects == {}
    assert np.linalg.norm(measured.gravity) == pytest.approx(9.81)
    assert truth.states[0] == pytest.approx(0.9 * truth.articulation.joint.upper)
    ideal = joint_motion(asset, truth.states)
    for run in measured.runs:
        off = se3.log_se3(se3.inverse(ideal) @ run.poses)
        assert 1.5e-3 < off[:, 3:].std() < 6e-3  # a tracker's errors, and no more: the frames are the truth's
    assert np.abs(measured.runs[0].poses - measured.runs[1].poses).max() > 1e-4
    geometry = find_geometry(asset, measured)
    assert geometry is not None and geometry.verdict == "no_gap"
    error = np.concatenate([track.q - truth.states for track in geometry.tracks])
    assert 0.5 * error.std() < geometry.tracks[0].q_std < 2 * error.std()
    loaded = load(asset, gravity=place(asset, measured.gravity).gravity)
    for effects, least, most in (((OIL,), 0.0, 2e-3), ((), 2e-2, 1.0)):
        loaded.set_effects(effects)
        rolled = roll_out(loaded, float(truth.states[0]), duration_s=44 / 30)
        off = np.interp(measured.runs[0].times_s, rolled.times_s, rolled.q) - truth.states
        assert least <= np.abs(off).max() < most
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"asset", "measured"}


def test_a_film_of_a_urdf_needs_that_urdf(tmp_path: Path):
    folder = tmp_path / "case"
    folder.mkdir()
    trimesh.creation.box((100, 100, 20)).export(folder / "lid.stl")
    trimesh.creation.box((0.1, 0.1, 0.04)).export(folder / "box.obj")
    light = URDF.replace('ixx="1" iyy="1" izz="1"', 'ixx="1e-4" iyy="1e-4" izz="1e-4"')
    light = light.replace("<inertial>", '<inertial><origin xyz="0 -0.05 0.01"/>')
    (folder / "case.urdf").write_text(light)  # its <dynamics> lose energy, the film's joint does not
    name = record(str(folder / "case.urdf"), tmp_path / "data", settings(tmp_path, let_go=0.9, effects_joint="hinge"))
    film = tmp_path / "data/truth" / name
    for urdf, message in (
        (None, "is of the URDF case; a truth holds its hash, not its files: give it as --urdf"),
        (tmp_path / "none.urdf", "is missing"),
    ):
        with pytest.raises(FreeArtError, match=message) as caught:
            measure_truths([film], tmp_path / "out", urdf=urdf)
        assert "\n" not in str(caught.value) and not (tmp_path / "out").exists()
    measure_truths([film], tmp_path / "out", urdf=folder / "case.urdf")
    asset, measured = read_asset(tmp_path / "out/asset"), read_measured(tmp_path / "out/measured")
    truth = read_truth(film)
    assert asset.effects == {} and measured.joint == asset.joint == "hinge"
    off = se3.log_se3(se3.inverse(joint_motion(asset, truth.states)) @ measured.runs[0].poses)
    assert 1.5e-3 < off[:, 3:].std() < 6e-3
    loaded = load(asset, gravity=place(asset, measured.gravity).gravity)
    rolled = roll_out(loaded, float(truth.states[0]), duration_s=44 / 30)
    states = np.interp(measured.runs[0].times_s, rolled.times_s, rolled.q)
    assert np.ptp(truth.states) > 0.5 and np.abs(states - truth.states).max() < 2e-3
    (folder / "case.urdf").write_text(light.replace("0.05 0.02", "0.05 0.03"))
    with pytest.raises(FreeArtError, match=r"case\.urdf is not the object of"):
        measure_truths([film], tmp_path / "other", urdf=folder / "case.urdf")


def test_a_result_becomes_one_run(tmp_path: Path, film: Path):
    truth = read_truth(film)
    answer, result = truth_as_answer(truth), tmp_path / "ours/seq"
    answer.seen[7] = False
    write_result(result, answer)
    with pytest.raises(FreeArtError, match="has no asset; make one by `freeart21 export"):
        measure_result(result, tmp_path / "out", (0, 9.81, 0), 30.0)
    measure_truths([film], tmp_path / "truths")
    shutil.copytree(tmp_path / "truths/asset", result / "asset")
    measure_result(result, tmp_path / "out", (0, 9.81, 0), 30.0)
    measured = read_measured(tmp_path / "out/measured")
    (run,) = measured.runs
    np.testing.assert_allclose(run.poses, joint_motion(read_asset(result / "asset"), truth.states), atol=1e-5)
    assert np.flatnonzero(~run.seen).tolist() == [7] and measured.rate_hz == 30
    header = result / "asset/asset.json"
    header.write_text(json.dumps({**json.loads(header.read_text()), "scale": 2.0}))
    measure_result(result, tmp_path / "twice", (0, 9.81, 0), 30.0)
    (twice,) = read_measured(tmp_path / "twice/measured").runs  # in the lengths of the asset
    np.testing.assert_allclose(twice.poses[:, :3, 3], 2 * run.poses[:, :3, 3], atol=1e-9)
    np.testing.assert_allclose(twice.poses[:, :3, :3], run.poses[:, :3, :3], atol=1e-9)
