"""The classical baselines: their parts on made-up numbers, and each of them on a rendered video."""

import numpy as np
import pytest
from baseline_scene import write_scene

from baselines import groups, masked_icp, rigid, rigid_clusters, two_motions
from baselines.answer import run_baseline
from baselines.video import UnsolvableError
from freeart21 import se3
from freeart21.files.asset import read_asset
from freeart21.files.result import read_result
from freeart21.reconstruction import Failure


@pytest.fixture(scope="module")
def videos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scenes")
    return {kind: write_scene(folder / kind, kind) for kind in ("revolute", "prismatic")}


def rng():
    return np.random.default_rng(0)


def test_poses_of_a_body_from_tracks_that_come_and_go():
    points = rng().normal(size=(200, 3)) * 0.1
    Ts = np.stack([se3.exp_se3(k * np.array([0.01, 0, 0, 0.1, 0.05, 0])) for k in range(12)])
    tracks = np.stack([se3.transform(T, points) for T in Ts], 1)
    begin = np.arange(200) // 20  # each lives for three frames or so
    for k, first in enumerate(begin):
        tracks[k, :first] = tracks[k, first + 3 :] = np.nan
    got, found = rigid.estimate_poses(tracks, 1e-3, rng())
    assert found.all()
    between = se3.inverse(got) @ Ts
    np.testing.assert_allclose(between, np.repeat(between[:1], 12, 0), atol=1e-6)
    tracks[:, 5:] = np.nan
    assert list(np.flatnonzero(rigid.estimate_poses(tracks, 1e-3, rng())[1])) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("vote", [groups.vote_by_motions, groups.vote_by_distances])
def test_tracks_of_two_bodies_are_separated(vote):
    pytest.importorskip("sklearn")
    points = rng().normal(size=(90, 3)) * 0.05
    body = np.stack([se3.exp_se3(k * np.array([0.01, 0, 0, 0.05, 0.02, 0])) for k in range(12)])
    other = body @ np.stack([se3.exp_se3(k * np.array([0, 0.01, 0, 0, 0, 0.1])) for k in range(12)])
    second = np.arange(90) >= 60
    tracks = np.where(
        second[:, None, None],
        np.stack([se3.transform(T, points) for T in other], 1),
        np.stack([se3.transform(T, points) for T in body], 1),
    )
    tracks[:10, 6:], tracks[80:, :6] = np.nan, np.nan
    tracks += rng().normal(size=tracks.shape) * 1e-4
    votes = vote(tracks, 2e-3, rng())
    parts = groups.agree(votes * rng().choice([-1, 1], votes.shape[1]))  # which side is called + means nothing
    assert (parts[parts >= 0] == second[parts >= 0]).mean() > 0.97 and (parts >= 0).mean() > 0.7
    still = vote(
        np.where(second[:, None, None], np.stack([se3.transform(T, points) for T in body], 1), tracks), 2e-3, rng()
    )
    with pytest.raises(UnsolvableError, match="two motions were found in 0"):
        groups.agree(still)


METHODS = {"two_motions": two_motions, "rigid_clusters": rigid_clusters, "masked_icp": masked_icp}


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize("name", METHODS)
def test_each_solves_a_textured_video(videos, tmp_path, name, kind):
    pytest.importorskip({"rigid_clusters": "sklearn", "masked_icp": "open3d"}.get(name, "cv2"))
    sequence, masks, truth = videos[kind]
    METHODS[name].main(sequence, tmp_path / "r", *([masks] if name == "masked_icp" else []), every=2)
    answer = read_result(tmp_path / "r")
    assert not isinstance(answer, Failure), answer
    true = truth.articulation.joint
    short_arc = name == "masked_icp" and kind == "revolute"  # the paper's cues, see above
    if not short_arc:
        assert answer.articulation.joint.type == kind
        between = answer.Ts_camera_reference[0] if same_reference(answer, truth) else answer.Ts_camera_moving[0]
        axis = between[:3, :3] @ answer.articulation.joint.axis
        expected = truth.Ts_camera_reference[0, :3, :3] @ true.axis
        assert np.degrees(np.arccos(min(abs(axis @ expected), 1))) < (
            12 if name == "masked_icp" else 6
        )  # flat boxes slide
        loose = name == "masked_icp"  # flat boxes slide in ICP
        assert np.ptp(answer.states) == pytest.approx(np.ptp(truth.states), rel=0.25 if loose else 0.1)
    labels = np.stack([truth.part_mask(i) for i in range(len(answer))])
    given = answer.part_masks if same_reference(answer, truth) else np.array([0, 2, 1])[answer.part_masks]
    assert (given == labels)[labels > 0].mean() > 0.9
    assert read_asset(tmp_path / "r" / "asset").moving_link == "moving"
    assert (tmp_path / "r" / "renders" / "00000.png").is_file()


def same_reference(answer, truth) -> bool:
    labels = np.stack([truth.part_mask(i) for i in range(len(answer))])
    return bool((answer.part_masks == labels)[labels > 0].mean() > 0.5)


def test_a_failure_is_declared_with_stage_and_reason(videos, tmp_path):
    def solve(video, rng):
        raise UnsolvableError("grouping", "nothing moves")

    run_baseline(solve, videos["revolute"][0], tmp_path / "r", 2, "none")
    answer = read_result(tmp_path / "r")
    assert isinstance(answer, Failure) and (answer.stage, answer.reason) == ("grouping", "nothing moves")
