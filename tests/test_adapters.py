"""Results of other projects: files of a made-up truth score perfectly, files written otherwise score badly."""

import numpy as np
import pytest
from adapters_case import (
    ANCHOR,
    GL,
    WRITERS,
    artgs,
    freeartgs,
    imported,
    itaco,
    lacks,
    official_example,
    screwsplat,
    tracked,
    truth_of,
)
from refusal import assert_refused

from freeart21.files.result import read_method, read_result
from freeart21.reconstruction import Failure
from leaderboard.adapters.importer import import_results
from leaderboard.adapters.layout import layouts
from leaderboard.adapters.readers import number_frames
from leaderboard.protocols.strict import STRICT_2

CLOUD = 1.0
"""% of the diagonal: Chamfer distance of a cloud of a few thousand points on the made-up object."""
WRITTEN = 0.01
"""% of the diagonal: Chamfer distance of meshes written with eight digits."""
VIDEO, TRACKED = ("renders",), ("masks", "renders")
TWO_STATES = ("states", "poses", "masks", "renders")
LACKS = {
    **dict.fromkeys(("freeartgs", "itaco"), VIDEO),
    **dict.fromkeys(("bundlesdf", "foundationpose"), TRACKED),
    **dict.fromkeys(("artgs", "articulate-anything", "screwsplat"), TWO_STATES),
}
CLOUDS = ("freeartgs", "itaco", "screwsplat")
"""Layouts whose parts are point clouds."""
STAMPS = [str(1581120424100262102 + 33333333 * i) for i in range(16)]
LABEL = {"frame": "label"}
PLACE = ("axis", "position", "chamfer_w")

pytestmark = pytest.mark.usefixtures("few_samples")


@pytest.fixture
def src(tmp_path):
    return tmp_path / "theirs"


@pytest.fixture
def run(data, tmp_path, src):
    """Imports what was written to `src` and returns the row of sequence `name`; options as the layout needs them."""
    examples = tmp_path / "official"
    for name in "abc":
        official_example(examples / "examples" / name, truth_of(name))

    def run(layout, name="a", **options):
        frame = layouts()[layout].frame
        defaults = {"anchor": ANCHOR} if frame is not None else {}
        if frame in ("zup", "link"):
            defaults["object_poses"] = examples
        return imported(data, src, tmp_path / "r", layout, name=name, **{**defaults, **options})

    return run


def notes_of(folder, name="a") -> str:
    return " ".join(read_method(folder).settings["notes"].get(name, ()))


def assert_perfect(row, lacks, chamfer):
    """Every metric that the layout has the pieces for is perfect, and no other has a value."""
    assert row.status == "ok"
    for metric in STRICT_2.metrics:
        value = row.values[metric.id]
        if metric.unit(row.joint_type) is None or {*lacks} & {*metric.needs}:
            assert value is None, metric.id
        elif metric.id.startswith("chamfer"):
            assert value < chamfer, metric.id
        elif metric.id in ("joint_type", "miou"):
            assert value == 1, metric.id
        elif metric.direction == "down":
            assert value < 0.01, metric.id


@pytest.mark.parametrize(
    "layout, name, folder, written, options, lacking",
    [
        *((layout, name, name, {}, {}, LACKS[layout]) for layout in LACKS for name in "ab"),
        ("itaco", "a", "a/chamfer/0", {}, {}, VIDEO),
        ("artgs", "a", "a", {"extra": True}, {"joint": "joint_1"}, TWO_STATES),
        ("artgs", "a", "a", {"extra": True}, {"joint": "0"}, TWO_STATES),
        ("articulate-anything", "a", "a/joint_actor/iter_0/seed_1", {}, {}, TWO_STATES),
        ("screwsplat", "a", "a", {"unit": 0.4}, {"scale": 0.4}, TWO_STATES),
        ("screwsplat", "a", "a", {"shown": None}, {}, TWO_STATES[1:]),
        ("foundationpose", "a", "a", {"names": STAMPS, "savetxt": True}, {}, TRACKED),
        ("bundlesdf", "a", "a", {"obj": "mesh_cleaned.obj"}, {}, ("masks", "meshes", "renders")),  # it is normalised
    ],
)
def test_files_of_the_truth_score_perfectly(tmp_path, src, run, layout, name, folder, written, options, lacking):
    WRITERS[layout](src / folder, name, **written)
    assert_perfect(run(layout, name, **options), lacking, CLOUD if layout in CLOUDS else WRITTEN)
    assert lacks(tmp_path / "r") == lacking
    assert ("in their order" in notes_of(tmp_path / "r", name)) == ("names" in written)


@pytest.mark.parametrize(
    "layout, written, options, ids, least",
    [
        ("freeartgs", {"wrong": "xyzw"}, {}, ["pose_rotation"], 20),
        ("freeartgs", {"wrong": "degrees"}, {}, ["state"], 60),
        ("freeartgs", {}, {"axes": "opengl"}, ["pose_rotation"], 20),
        ("itaco", {"sign": 1}, {}, ["state"], 20),
        ("itaco", {}, {"axes": "opencv"}, ["pose_rotation"], 20),
        ("artgs", {}, LABEL, PLACE, 10),
        ("artgs", {}, {"frame": "link"}, PLACE, 10),
        ("artgs", {}, {"anchor": 9}, ["chamfer_m"], 1),
        ("artgs", {}, {"scale": 2.0}, ["chamfer_w"], 5),
        ("articulate-anything", {}, LABEL, ["chamfer_w"], 5),
        ("bundlesdf", {"of": lambda Ts: GL @ Ts}, {}, ["pose_rotation"], 5),
        ("bundlesdf", {"of": np.linalg.inv}, {}, ["pose_rotation"], 5),
    ],
)
def test_files_of_another_convention_score_badly(src, run, layout, written, options, ids, least):
    WRITERS[layout](src / "a", **written)
    row = run(layout, **options)
    assert max(row.values[id] for id in ids) > least


# ---- FreeArtGS and iTACO


def test_freeartgs_clouds_are_at_the_trained_value_zero_and_a_note_says_when_it_is_unknown(tmp_path, src, run):
    freeartgs(src / "a", with_training=False)
    row = run("freeartgs")
    assert row.values["chamfer_m"] > CLOUD and row.values["state"] < 0.01  # 0.2 rad off, an offset of the states
    assert "articulation.json" in notes_of(tmp_path / "r")


def test_freeartgs_frames_go_by_their_names_and_others_by_the_nearest(tmp_path, src, run):
    frames = [0, 1, 2, 4, 5, 7, 9, 11, 13, 15]
    freeartgs(src / "a", frames=frames)
    run("freeartgs")
    answer, truth = read_result(tmp_path / "r" / "a"), truth_of()
    assert list(np.flatnonzero(answer.seen.all(1))) == frames
    assert np.ptp((answer.states - truth.states)[frames]) < 1e-9  # one offset: no frame is another's
    assert not answer.part_masks[3].any() and answer.part_masks[4].any()
    assert "6 of 16 frames" in notes_of(tmp_path / "r")


@pytest.mark.parametrize(
    "losses, shift, joint_type",
    [
        ((0.01, 0.5), 0, "revolute"),
        ((0.5, 0.01), 0, "prismatic"),
        ((0.5, None), 0, "revolute"),
        ((0.01, 0.5), 5, "prismatic"),  # a hinge far from the surface is a slider
        ((None, None), 0, None),
    ],
)
def test_itaco_chooses_the_type_and_without_a_loss_declares_a_failure(tmp_path, src, data, losses, shift, joint_type):
    itaco(src / "a", losses=losses)
    path = src / "a" / "revolute" / "joint_pos.npy"
    np.save(path, np.load(path) + shift)
    report = import_results("itaco", src, data, tmp_path / "r")
    answer = read_result(tmp_path / "r" / "a")
    if joint_type is None:
        assert report.failures == ("a",) and isinstance(answer, Failure)
    else:
        assert answer.articulation.joint.type == joint_type


# ---- methods of two states


def test_artgs_with_two_joints_needs_a_choice(src, run):
    artgs(src / "a", extra=True)
    assert_refused("joints joint_1, joint_2; expected one, or --joint", run, "artgs")


def test_artgs_meshes_stay_in_the_folder(src, run):
    path = artgs(src / "a") / "joint_info.json"
    path.write_text(path.read_text().replace("meshes/start_1.ply", "../../../../secret.ply"))
    assert_refused("leads out of the folder", run, "artgs")


def test_screwsplats_own_pickles_are_not_read(src, run):
    screwsplat(src / "a")
    np.save(src / "a" / "screws.npy", {"joint_0": {"screw": [0.0] * 6}}, allow_pickle=True)
    assert_refused("without pickled objects", run, "screwsplat")


# ---- methods that track parts


def test_one_run_gives_the_reference_parts_poses_and_no_joint(tmp_path, src, run):
    truth = truth_of()
    tracked(src / "a", truth.Ts_camera_reference, truth.articulation.reference, 4)
    row = run("bundlesdf")
    assert row.values["pose_rotation"] < 0.01 and row.values["pose_translation"] < 0.01
    assert lacks(tmp_path / "r") == ("joint", "states", "masks", "meshes", "renders")
    assert row.values["axis"] is None and row.values["joint_type"] is None
    assert "no joint" in notes_of(tmp_path / "r")


@pytest.mark.parametrize(
    "stems, expected",
    [
        (["0000", "0001", "0002"], [0, 1, 2]),
        (["00000", "00002"], [0, 2]),
        (["1", "2", "3"], [0, 1, 2]),
        (["10", "9", "200"], [1, 0, 2]),
        (["b", "a", "c"], [1, 0, 2]),
        (["0", "7"], None),
        (["00", "0"], None),
        ([], None),
    ],
)
def test_names_of_frames(stems, expected):
    if expected is None:
        assert_refused("here", number_frames, stems, 3, "here")
    else:
        assert number_frames(stems, 3, "here")[0].tolist() == expected
