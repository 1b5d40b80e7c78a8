"""Results of other projects: their frames and units proved by a known point, and their faults told in one line."""

import numpy as np
import pytest
from adapters_case import (
    evaluation_data,
    few_samples,
    imported,
    lacks,
    rigid,
    truth_of,
    write_data,
    write_json,
)
from scipy.spatial.transform import Rotation
from score_files import score_one

from freeart21.files.result import read_method, read_result
from freeart21.reconstruction import Failure
from leaderboard.adapters.importer import import_results
from leaderboard.sequence_score import score_sequence

CLOUD = 1.0
"""% of the diagonal: what a cloud of a few thousand points leaves of Chamfer distance on the made-up object."""


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_data(tmp_path_factory.mktemp("data"))


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    few_samples(monkeypatch)


@pytest.fixture
def src(tmp_path):
    return tmp_path / "theirs"


def assert_perfect(row, *, position=True, state=True, poses=True, masks=True, chamfer=CLOUD):
    v = row.values
    assert row.status == "ok" and v["joint_type"] == 1
    assert v["axis"] < 0.01
    if position:
        assert v["position"] < 0.01
    if state:
        assert v["state"] < 0.01 and v["state_all"] < 0.01
    if poses:
        for id in ("pose_rotation", "pose_translation", "pose_moving_rotation", "pose_moving_translation"):
            assert v[id] < 0.01, id
    if masks:
        assert v["miou"] == 1
    if chamfer is not None:
        for id in ("chamfer_w", "chamfer_m", "chamfer_s"):
            assert v[id] < chamfer, id


# FreeArtGS


def freeartgs(folder, name="a", *, with_training=True, frames=None, wrong=None):
    """`outputs/<id>` as FreeArtGS leaves it, trained with the clouds at joint state 0.2 of the truth's."""
    truth = truth_of(name)
    joint, n, world = truth.articulation.joint, len(truth), rigid(1)
    home = folder / "evaluation_data"
    trained = truth.states - 0.2
    quaternion = (lambda R: Rotation.from_matrix(R).as_quat()) if wrong == "xyzw" else None
    more = {"wxyz_of": quaternion} if quaternion else {}
    kind = evaluation_data(home, truth, world=world, stand=0.2, sign=1, axes="opencv", zoom=2, **more)
    values = trained - trained[0]
    np.save(kind / "joint_value.npy", np.degrees(values) if wrong == "degrees" else values)
    if wrong != "xyzw":
        cameras = [world @ np.linalg.inv(T) for T in truth.Ts_camera_reference]
        named = [{"file_path": f"images/{i:05d}.png", "transform_matrix": T.tolist()} for i, T in enumerate(cameras)]
        write_json(kind / "camera_poses.json", named)
        if frames is not None:
            write_json(kind / "camera_poses.json", [named[i] for i in frames])
            np.save(kind / "joint_value.npy", values[frames])
            maps = np.load(kind / "moving_map.npz")["a"]
            np.savez_compressed(kind / "moving_map.npz", a=maps[frames])
    (kind / "best_loss.txt").write_text("0.001\n")
    manifest = {"joint_type": joint.type, "exported_joint_types": [joint.type], "motion_part": 1}
    write_json(home / "export_manifest.json", manifest | {"weight_threshold": 0.5, "part_weight_margin": 0.3})
    if with_training:
        key = "angle_rad" if joint.type == "revolute" else "distance"
        art = {"joint_type": joint.type, "joint_axis_world": [0, 0, 1], "joint_origin_world": [0, 0, 0]}
        art["frames"] = [
            {key: float(q), "frame_index": i} for i, q in enumerate(trained[range(n) if frames is None else frames])
        ]
        write_json(folder / "splatfacto-art" / "articulation.json", art)
    return folder


@pytest.mark.parametrize("name", ["a", "b"])
def test_freeartgs(data, tmp_path, name):
    freeartgs(tmp_path / "outputs" / name, name)
    row = imported(data, tmp_path / "outputs", tmp_path / "r", "freeartgs", name=name)
    assert_perfect(row, position=name == "a")
    assert lacks(tmp_path / "r") == ("renders",)


@pytest.mark.parametrize("wrong, id, least", [("xyzw", "pose_rotation", 20), ("degrees", "state", 60)])
def test_freeartgs_written_otherwise_scores_badly(data, tmp_path, wrong, id, least, src):
    freeartgs(src / "a", wrong=wrong)
    assert imported(data, src, tmp_path / "r", "freeartgs").values[id] > least


def test_freeartgs_without_named_frames_has_one_a_frame_of_the_video(data, tmp_path, src):
    freeartgs(src / "a")
    (src / "a" / "evaluation_data" / "revolute" / "camera_poses.json").unlink()
    assert_perfect(imported(data, src, tmp_path / "r", "freeartgs"))


def test_freeartgs_with_cameras_of_opengl_scores_badly(data, tmp_path, src):
    freeartgs(src / "a")
    row = imported(data, src, tmp_path / "r", "freeartgs", axes="opengl")
    assert row.values["pose_rotation"] > 20 and row.values["chamfer_s"] > 10


def test_freeartgs_clouds_stand_where_the_trained_value_is_zero_and_that_is_said_when_unknown(data, tmp_path, src):
    freeartgs(src / "a", with_training=False)
    row = imported(data, src, tmp_path / "r", "freeartgs")
    assert row.values["chamfer_m"] > CLOUD and row.values["state"] < 0.01  # 0.2 rad off, an offset of the states
    assert any("articulation.json" in line for line in read_method(tmp_path / "r").settings["notes"]["a"])


def test_freeartgs_frames_go_by_their_names_and_the_others_by_the_nearest(data, tmp_path, src):
    frames = [0, 1, 2, 4, 5, 7, 9, 11, 13, 15]
    freeartgs(src / "a", frames=frames)
    imported(data, src, tmp_path / "r", "freeartgs")
    answer, truth = read_result(tmp_path / "r" / "a"), truth_of()
    assert list(np.flatnonzero(answer.seen.all(1))) == frames
    assert np.ptp((answer.states - truth.states)[frames]) < 1e-9  # one offset: no frame is another's
    assert not answer.part_masks[3].any() and answer.part_masks[4].any()
    assert any("6 of 16 frames" in line for line in read_method(tmp_path / "r").settings["notes"]["a"])


# iTACO


def itaco(folder, name="a", *, losses=(0.01, 0.5), sign=-1, axes="opengl", right=None):
    """Refined joints as iTACO saves them: both hypotheses, the right one of the first loss."""
    truth = truth_of(name)
    right = right or truth.articulation.joint.type
    other = {"revolute": "prismatic", "prismatic": "revolute"}[right]
    stand = truth.states[0]
    for kind, loss in zip((right, other), losses, strict=True):
        noise = 0 if kind == right else np.linspace(0, 0.5, len(truth))
        home = evaluation_data(
            folder, truth, world=rigid(2), stand=stand, sign=sign, axes=axes, soft=True, kind=kind, noise=noise
        )
        if loss is not None:
            (home / "best_loss.txt").write_text(str(loss))
    return folder


@pytest.mark.parametrize("name", ["a", "b"])
def test_itaco(data, tmp_path, name):
    itaco(tmp_path / "results" / name / "chamfer" / "0", name)
    report = import_results("itaco", tmp_path / "results" / name / "chamfer" / "0", data, tmp_path / "r", sequence=name)
    assert report.sequences == (name,) and set(report.missing) == {"a", "b", "c"} - {name}
    row = score_one(data, tmp_path / "r" / name, name)
    assert_perfect(row, position=name == "a")
    assert lacks(tmp_path / "r") == ("renders",)


@pytest.mark.parametrize("layout", ["itaco", "freeartgs"])
@pytest.mark.parametrize("name", ["a", "b"])
def test_itacos_own_protocol_which_removes_no_offset_of_the_states(data, tmp_path, src, name, layout):
    {"itaco": itaco, "freeartgs": freeartgs}[layout](src / name, name)
    import_results(layout, src, data, tmp_path / "r")
    where = tmp_path / "r" / name, data / "sequences" / name, data / "truth" / name
    values = score_sequence(*where, "itaco-1", lacks(tmp_path / "r")).values
    assert values["joint_type"] == 1 and values["miou"] == 1
    for id in ("axis", "state", "camera_rotation", "camera_position", *(("position",) if name == "a" else ())):
        assert values[id] < 1e-6, id


def test_itaco_turns_the_seen_part_back_to_the_surface(data, tmp_path, src):
    itaco(src / "a", sign=1)  # as FreeArtGS counts
    assert imported(data, src, tmp_path / "r", "itaco").values["state"] > 20


@pytest.mark.parametrize("axes, least", [("opengl", 0), ("opencv", 20)])
def test_itaco_has_cameras_of_opengl_unless_told(data, tmp_path, axes, least, src):
    itaco(src / "a", axes="opengl")
    row = imported(data, src, tmp_path / "r", "itaco", axes=axes)
    assert row.values["pose_rotation"] >= least and (row.values["pose_rotation"] < 0.01) == (least == 0)


@pytest.mark.parametrize(
    "losses, kind", [((0.01, 0.5), "revolute"), ((0.5, 0.01), "prismatic"), ((0.5, None), "revolute")]
)
def test_itaco_chooses_the_type_by_the_smaller_loss(data, tmp_path, losses, kind, src):
    itaco(src / "a", losses=losses)
    import_results("itaco", src, data, tmp_path / "r")
    assert read_result(tmp_path / "r" / "a").articulation.joint.type == kind


def test_itaco_calls_a_hinge_far_from_the_surface_a_slider(data, tmp_path, src):
    itaco(src / "a")
    position = np.load(src / "a" / "revolute" / "joint_pos.npy")
    np.save(src / "a" / "revolute" / "joint_pos.npy", position + 5)
    import_results("itaco", src, data, tmp_path / "r")
    assert read_result(tmp_path / "r" / "a").articulation.joint.type == "prismatic"


def test_itaco_without_a_loss_is_a_declared_failure(data, tmp_path, src):
    itaco(src / "a", losses=(None, None))
    report = import_results("itaco", src, data, tmp_path / "r")
    assert report.failures == ("a",) and isinstance(read_result(tmp_path / "r" / "a"), Failure)
