"""Diagnostics: numbers known in closed form, files that are refused, and a page that tells."""

import base64
import json
from dataclasses import replace

import cv2
import numpy as np
import page_data as view
import pytest

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files.diagnostics import (
    FILE,
    Diagnostics,
    diagnostics_to_json,
    read_confidence,
    read_diagnostics,
)
from freeart21.files.result import read_result, write_result
from freeart21.joint import Joint
from freeart21.recording import Frame, Recording
from freeart21.view import page
from freeart21.view.diagnosis import warnings
from reconstruct.diagnostics import diagnose, measure_agreement
from reconstruct.evidence import Evidence
from reconstruct.poses import GATE, FreePoses, JointedPoses, part_samples
from reconstruct.propagation import PartEstimate
from reconstruct.scene import prepare_scene
from reconstruct.settings import EvidenceSettings, LabelSettings, PoseSettings, SceneSettings

N, H, W, DEPTH, FOCAL = 6, 40, 48, 1.0, 100.0
SETTINGS = (PoseSettings(),)


def walls(bulge=0.0, hole=False, recede=0.0):
    """A flat wall at 1 m, filmed six times by a camera that stands still: left half reference, right half moving part.

    Frame 2 shows it farther off by `bulge`, metres, every frame by `recede` farther than the last. With `hole` the mask
    of the last frames lacks the upper half. Every second pixel each way is left of the picture.
    """
    size = (2 * W, 2 * H)
    camera = Camera(np.array([[2 * FOCAL, 0, W], [0, 2 * FOCAL, H], [0, 0, 1.0]]), *size)

    def load(i):
        mask = np.ones(size[::-1], bool)
        mask[: H if hole and i >= 3 else 0] = False
        depth = np.where(mask, DEPTH + recede * i + (bulge if i == 2 else 0), 0).astype(np.float32)
        return Frame(np.zeros((*mask.shape, 3), np.uint8), depth, mask)

    scene = prepare_scene(
        Recording(camera, np.arange(N) / 30, load), SceneSettings(max_crop_pixels=H * W, min_frames=N)
    )
    labels = np.where(np.arange(W) < W / 2, 1, 2).astype(np.uint8) * scene.mask
    return Evidence(scene, EvidenceSettings(), LabelSettings()), labels


def measured(evidence, labels, Ts, part=1, gate=0.05):
    samples = part_samples(evidence, labels, part, 200, np.random.default_rng(0), np.ones(N, bool))
    i, j = np.nonzero(~np.eye(N, dtype=bool))
    return measure_agreement(evidence, labels, part, Ts, samples, (i, j), gate)


def still(offset=0.0, frame=2):
    Ts = np.tile(np.eye(4), (N, 1, 1))
    Ts[frame, 2, 3] = offset
    return Ts


# ---------------------------------------------------------------- what the solver measures


@pytest.mark.parametrize("part", [1, 2])
def test_perfect_frames_agree_perfectly(part):
    evidence, labels = walls()
    assert measured(evidence, labels, still(), part) == pytest.approx(np.tile([1.0, 0.0, 0.0], (N, 1)), abs=1e-6)


def test_a_pose_too_near_shows_as_that_distance():
    """Frame 2 is posed 3 mm off: all its pairs miss by that, and one in five of each other frame's."""
    evidence, labels = walls()
    inliers, outside, residual = measured(evidence, labels, still(0.003)).T
    assert residual[2] == pytest.approx(0.003, rel=1e-3)
    assert residual[[0, 1, 3, 4, 5]] == pytest.approx(0.003 / np.sqrt(5), rel=1e-2)
    assert inliers == pytest.approx(np.ones(N)) and outside == pytest.approx(np.zeros(N))


def grown_of(labels, joint_off=0.0, hidden=None):
    joint = Joint("j", "prismatic", np.array([1.0, 0, 0]), np.zeros(3), 0.0, 0.1)
    Ts = still(joint_off)
    seen = np.ones((N, 2), bool)
    if hidden is not None:
        seen[hidden, 1] = False
    poses = JointedPoses(joint, np.zeros(N), Ts, np.full(N, 0.001), 0.1)
    return PartEstimate(poses, labels, np.where(labels == 2, 3.0, -3.0).astype(np.float32), seen)


def test_diagnosis_of_both_parts_by_both_kinds_of_poses():
    evidence, labels = walls()
    free = tuple(FreePoses(still(), np.zeros((N, 6, 6))) for _ in range(2))
    found = diagnose(
        evidence,
        grown_of(labels, joint_off=0.002, hidden=4),
        free,
        PoseSettings(),
        size=(2 * W, 2 * H),
    )
    assert found.confidence_maps.shape == (N, 2 * H, 2 * W) and (found.confidence_maps == 243).all(), "255 / (1 + e^-3)"
    assert found.pixels == pytest.approx(np.full((N, 2), H * W / 2 * 4)), "two by two pixels of the picture each"
    assert found.confidence == pytest.approx(np.full((N, 2), 1 / (1 + np.exp(-3.0))))
    assert found.residual_m[[0, 1, 2, 3, 5]] == pytest.approx(np.zeros((5, 2)), abs=1e-6)
    assert found.jointed_residual_m[2] == pytest.approx([0.002, 0.002], rel=1e-3)
    assert np.isnan(found.residual_m[4, 1]) and found.residual_m[4, 0] == pytest.approx(0, abs=1e-6)
    assert found.gate_m == pytest.approx(GATE * evidence.unit)
    again = diagnose(evidence, grown_of(labels, joint_off=0.002, hidden=4), free, *SETTINGS)
    assert diagnostics_to_json(found) | {"peak_bytes": 0} == diagnostics_to_json(again) | {"peak_bytes": 0}


# ---------------------------------------------------------------- the file


def sample_diagnostics(n=view.N):
    rng = np.random.default_rng(0)
    residual = rng.uniform(0.0005, 0.0006, (n, 2))
    residual[0, 1] = np.nan
    return Diagnostics(
        rng.integers(100, 1000, (n, 2)).astype(float),
        rng.uniform(0.9, 1, (n, 2)),
        rng.uniform(0.9, 1, (n, 2)),
        np.zeros((n, 2)),
        residual,
        residual * 1.01,
        0.004,
        0.0004,
        0.0001,
        0.2,
        1_500_000_000,
    )


def test_round_trip(tmp_path):
    result, found = view.perfect_result(view.make_truth()), sample_diagnostics()
    write_result(tmp_path / "r", result, diagnostics=found)
    back = read_diagnostics(tmp_path / "r", view.N)
    assert back.residual_m == pytest.approx(found.residual_m, rel=1e-5, nan_ok=True)
    assert diagnostics_to_json(back) == diagnostics_to_json(found)
    assert isinstance(read_result(tmp_path / "r"), type(result))
    write_result(tmp_path / "r", result)
    assert read_diagnostics(tmp_path / "r", view.N) is None, "an older result has none"


def test_confidence_maps_stand_beside_the_masks_and_in_the_page(tmp_path):
    result = view.perfect_result(view.make_truth())
    maps = np.where(result.part_masks > 0, 255, 0).astype(np.uint8)
    maps[:, 8:16] //= 2
    found = replace(sample_diagnostics(), confidence_maps=maps)
    write_result(tmp_path / "r", result, diagnostics=found)
    assert (read_confidence(tmp_path / "r", 3, maps.shape[1:]) == maps[3]).all()
    (player,) = [data for data in view.Parsed(page(tmp_path / "r")).data if "sources" in data]
    (source,) = player["sources"]
    image = cv2.imdecode(np.frombuffer(base64.b64decode(source["labels"][3].split(",")[1]), np.uint8), 0)
    assert source["confidence"] and set(np.unique(image)) == {0, 120, 140, 220, 240}
    assert (np.floor(image / 100 + 0.1) == result.part_masks[3]).all(), "what the scripts make of it"
    with pytest.raises(FreeArtError, match="is 48 x 32, expected 48 x 31 as the part masks"):
        read_confidence(tmp_path / "r", 3, (31, 48))
    (tmp_path / "r" / "confidence" / "00004.png").unlink()
    assert "The diagnostics cannot be shown" in page(tmp_path / "r")
    with pytest.raises(FreeArtError, match="confidence_maps has shape"):
        replace(found, confidence_maps=maps[:2])


@pytest.mark.parametrize(
    "change, message",
    [
        ({"schema": "freeart21/diagnostics/9"}, "schema 'freeart21/diagnostics/9'"),
        ({"residual_m": [[0.0, 0.0]]}, "residual_m has shape (1, 2), expected (6, 2)"),
        ({"residual_m": [[0.0, -1.0]] * view.N}, "'residual_m' reaches from -1"),
        ({"pixels": [[0.0, float("inf")]] * view.N}, "'pixels' reaches"),
        ({"outside": None}, "'outside'"),
    ],
)
def test_bad_files_are_reported_in_one_line_and_the_page_goes_on(tmp_path, change, message):
    write_result(tmp_path / "r", view.perfect_result(view.make_truth()), diagnostics=sample_diagnostics())
    path = tmp_path / "r" / FILE
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(FreeArtError) as caught:
        read_diagnostics(tmp_path / "r", view.N)
    assert message in str(caught.value) and str(path) in str(caught.value) and "\n" not in str(caught.value)
    assert "The diagnostics cannot be shown" in page(tmp_path / "r")


# ---------------------------------------------------------------- what a result says of itself


def long_result(n=60, hidden=(), joint_type="revolute"):
    """A perfect result of n frames, smooth in time."""
    truth = view.make_truth(joint_type)
    t = np.linspace(0, 1, n)
    Ts = se3.pose(se3.exp_so3(t[:, None] * [0.4, 0.9, 0.2]), t[:, None] * [0.05, 0, 0] + [0, 0, 0.8])
    states = 0.5 - 0.5 * np.cos(2 * np.pi * t)
    seen = np.ones((n, 2), bool)
    seen[list(hidden), 1] = False
    joint = truth.articulation.joint
    result = view.perfect_result(truth)
    return replace(
        result,
        articulation=truth.articulation,
        states=states,
        Ts_camera_reference=Ts,
        Ts_camera_moving=Ts @ joint.transform(states),
        part_masks=np.repeat(result.part_masks[:1], n, 0),
        seen=seen,
        state_std=None,
    )


def warnings_of(result, diagnostics=None):
    return [(remark.where, remark.text) for remark in warnings(result, diagnostics)]


def test_hidden_parts_are_reported():
    assert warnings_of(long_result(hidden=range(20, 31))) == [
        ("frames 20-30", "the moving part was not seen; its states are not measured")
    ]
    assert warnings_of(long_result(hidden=[59])) == [
        ("frame 59", "the moving part was not seen; its states are not measured")
    ]


def test_a_jump_and_a_pose_off_the_joint_are_reported():
    result = long_result()
    moving = result.Ts_camera_moving.copy()
    moving[40] = moving[40] @ se3.exp_se3([0, 0, 0, 0.3, 0, 0])
    found = warnings_of(replace(result, Ts_camera_moving=moving))
    assert {where for where, _ in found} == {"frame 40", "frame 41"}, found
    assert any("pose deviates from the joint by 17.2° and" in text for _, text in found)
    assert any("the moving part turns by" in text for _, text in found)
    both = replace(result, Ts_camera_reference=result.Ts_camera_reference.copy(), Ts_camera_moving=moving)
    both.seen[40, 1] = False
    assert all("not seen" in text for _, text in warnings_of(both)), "what was not seen is not judged"


# ---------------------------------------------------------------- the page


def test_page_of_a_result_tells_what_it_should(tmp_path):
    shares = np.full((view.N, 2), 0.5)
    found = replace(sample_diagnostics(), uncovered=shares, spilled=0.1 * shares, off_surface=0.01 * shares)
    found = replace(found, colour_residual=shares, extent_ratio=np.array([1.1, 860]), seen_share=np.array([0.9, 0.2]))
    write_result(tmp_path / "r", view.perfect_result(view.make_truth()), diagnostics=found)
    text = page(tmp_path / "r")
    for words in ("Warnings", "Residual", "Label confidence", "Joint residual", "1.50 GB", "Frames 2-3"):
        assert words in text
    for words in ("Surface outside the mask", "Depth off the surface"):
        assert words in text
    _, charts = [data for data in view.Parsed(text).data if "charts" in data]
    assert len(charts["charts"]) == 13 and len(charts["x"]) == view.N
    assert charts["charts"][0][1][0] is None, "the moving part's residual in frame 0 is not known"
