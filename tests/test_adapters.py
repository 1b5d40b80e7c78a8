"""Results of other projects: files of a made-up truth score perfectly, files written otherwise score badly."""

import json

import numpy as np
import pytest
from adapters_case import (
    ANCHOR,
    GL,
    SCALE,
    WRITERS,
    artgs,
    digitaltwinart,
    freeartgs,
    imported,
    itaco,
    lacks,
    official_example,
    paris,
    rigid,
    rsrd,
    runs_of,
    screwsplat,
    tracked,
    truth_of,
    write_json,
)
from refusal import assert_refused

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files.result import read_method, read_result
from freeart21.joint import Joint
from freeart21.reconstruction import Failure
from leaderboard.adapters.fitting import fit_joint
from leaderboard.adapters.importer import import_results
from leaderboard.adapters.readers import number_frames
from leaderboard.adapters.registry import layouts
from leaderboard.protocols.strict2 import STRICT_2
from leaderboard.sequence_score import score_sequence

CLOUD = 1.0
"""% of the diagonal: Chamfer distance of a cloud of a few thousand points on the made-up object."""
WRITTEN = 0.01
"""% of the diagonal: Chamfer distance of meshes written with eight digits."""
VIDEO, TRACKED = ("renders",), ("masks", "renders")
TWO_STATES = ("states", "poses", "masks", "renders")
LACKS = {
    **dict.fromkeys(("freeartgs", "itaco"), VIDEO),
    **dict.fromkeys(("rsrd", "bundlesdf", "foundationpose"), TRACKED),
    **dict.fromkeys(("paris", "digitaltwinart", "artgs", "articulate-anything", "screwsplat"), TWO_STATES),
}
CLOUDS = ("freeartgs", "itaco", "rsrd", "screwsplat")
"""Layouts whose parts are point clouds."""
STAMPS = [str(1581120424100262102 + 33333333 * i) for i in range(16)]

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
        if frame in ("zup", "link") and options.get("frame") != "camera":
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


# ---- perfect and bad


@pytest.mark.parametrize("name", "ab")
@pytest.mark.parametrize("layout", LACKS)
def test_files_of_the_truth_score_perfectly(tmp_path, src, run, layout, name):
    WRITERS[layout](src / name, name)
    assert_perfect(run(layout, name), LACKS[layout], CLOUD if layout in CLOUDS else WRITTEN)
    assert lacks(tmp_path / "r") == LACKS[layout]


@pytest.mark.parametrize(
    "layout, folder, written, options, lacking",
    [
        ("itaco", "a/chamfer/0", {}, {}, VIDEO),
        ("paris", "a", {"start_mesh": False}, {}, TWO_STATES),
        ("paris", "a", {"world": truth_of().Ts_camera_reference[ANCHOR]}, {"frame": "camera"}, TWO_STATES),
        ("digitaltwinart", "a", {"known": False}, {}, TWO_STATES),
        ("artgs", "a", {"extra": True}, {"joint": "joint_1"}, TWO_STATES),
        ("artgs", "a", {"extra": True}, {"joint": "0"}, TWO_STATES),
        ("articulate-anything", "a/joint_actor/iter_0/seed_1", {}, {}, TWO_STATES),
        ("screwsplat", "a", {"unit": 0.4}, {"scale": 0.4}, TWO_STATES),
        ("screwsplat", "a", {"shown": None}, {}, TWO_STATES[1:]),
        ("rsrd", "a", {"scale_file": False}, {"scale": 1 / SCALE}, TRACKED),
        ("foundationpose", "a", {"names": STAMPS, "savetxt": True}, {}, TRACKED),
        ("bundlesdf", "a", {"obj": "mesh_cleaned.obj"}, {}, ("masks", "meshes", "renders")),  # it is normalised
    ],
)
def test_variants_score_perfectly(tmp_path, src, run, layout, folder, written, options, lacking):
    WRITERS[layout](src / folder, **written)
    assert_perfect(run(layout, **options), lacking, CLOUD if layout in CLOUDS else WRITTEN)
    assert lacks(tmp_path / "r") == lacking
    if "names" in written:
        assert "in their order" in notes_of(tmp_path / "r")


PLACE = ("axis", "position", "chamfer_w")


@pytest.mark.parametrize(
    "layout, written, options, ids, least",
    [
        ("freeartgs", {"wrong": "xyzw"}, {}, ["pose_rotation"], 20),
        ("freeartgs", {"wrong": "degrees"}, {}, ["state"], 60),
        ("freeartgs", {}, {"axes": "opengl"}, ["pose_rotation"], 20),
        ("itaco", {"sign": 1}, {}, ["state"], 20),
        ("itaco", {}, {"axes": "opencv"}, ["pose_rotation"], 20),
        ("paris", {}, {"frame": "label"}, PLACE, 10),
        ("paris", {}, {"frame": "link"}, PLACE, 10),
        ("paris", {}, {"anchor": 9}, ["chamfer_m"], 1),
        ("paris", {}, {"scale": 2.0}, ["chamfer_w"], 5),
        ("articulate-anything", {}, {"frame": "label"}, ["chamfer_w"], 5),
        ("rsrd", {"order": "xyzw"}, {}, ["pose_rotation"], 5),
        ("rsrd", {"scale_file": False}, {}, ["pose_translation"], 10),
        ("rsrd", {"camera": np.eye(4)}, {}, ["pose_rotation"], 5),
        ("bundlesdf", {"of": lambda Ts: GL @ Ts}, {}, ["pose_rotation"], 5),
        ("bundlesdf", {"of": np.linalg.inv}, {}, ["pose_rotation"], 5),
    ],
)
def test_files_of_another_convention_score_badly(src, run, layout, written, options, ids, least):
    WRITERS[layout](src / "a", **written)
    row = run(layout, **options)
    assert max(row.values[id] for id in ids) > least


def test_screwsplat_with_v_before_w_has_another_joint_type(src, run):
    screwsplat(src / "b", "b", order="vw")
    assert run("screwsplat", "b").values["joint_type"] == 0


@pytest.mark.parametrize(
    "layout, end",
    [("paris", 1.0), ("digitaltwinart", 1.0), ("articulate-anything", None), ("artgs", np.inf)],
)
@pytest.mark.parametrize("name", "ab")
def test_limits(tmp_path, src, run, layout, end, name):
    """From the first state to `end` rad (or end/5 m); ArtGS has no limits, Articulate-Anything those of its URDF."""
    WRITERS[layout](src / name, name)
    run(layout, name)
    joint = read_result(tmp_path / "r" / name).articulation.joint
    if end is None:
        assert (joint.lower, joint.upper) == (0.0, 1.2)
    elif np.isinf(end):
        assert np.isinf([joint.lower, joint.upper]).all()
    else:
        amount = abs((end if name == "a" else end / 5) - truth_of(name).states[ANCHOR])
        assert joint.upper - joint.lower == pytest.approx(amount)
    assert read_result(tmp_path / "r" / name).anchor == ANCHOR


def test_lengths_are_scaled(tmp_path, src, run):
    paris(src / "b", "b")
    run("paris", "b", scale=2.0)
    joint = read_result(tmp_path / "r" / "b").articulation.joint
    assert joint.upper - joint.lower == pytest.approx(2 * (0.2 - truth_of("b").states[ANCHOR]))


# ---- FreeArtGS and iTACO


def test_freeartgs_without_camera_names_has_one_frame_per_frame_of_the_video(src, run):
    freeartgs(src / "a")
    (src / "a" / "evaluation_data" / "revolute" / "camera_poses.json").unlink()
    assert_perfect(run("freeartgs"), VIDEO, CLOUD)


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


@pytest.mark.parametrize("layout", ["itaco", "freeartgs"])
@pytest.mark.parametrize("name", "ab")
def test_itacos_own_protocol_which_removes_no_offset_of_the_states(data, tmp_path, src, name, layout):
    WRITERS[layout](src / name, name)
    import_results(layout, src, data, tmp_path / "r")
    where = tmp_path / "r" / name, data / "sequences" / name, data / "truth" / name
    values = score_sequence(*where, "itaco-1", lacks(tmp_path / "r")).values
    assert values["joint_type"] == 1 and values["miou"] == 1
    for id in ("axis", "state", "camera_rotation", "camera_position", *(("position",) if name == "a" else ())):
        assert values[id] < 1e-6, id


@pytest.mark.parametrize(
    "losses, shift, joint_type",
    [
        ((0.01, 0.5), 0, "revolute"),
        ((0.5, 0.01), 0, "prismatic"),
        ((0.5, None), 0, "revolute"),
        ((0.01, 0.5), 5, "prismatic"),  # a hinge far from the surface is a slider
    ],
)
def test_itaco_chooses_the_type(tmp_path, src, data, losses, shift, joint_type):
    itaco(src / "a", losses=losses)
    path = src / "a" / "revolute" / "joint_pos.npy"
    np.save(path, np.load(path) + shift)
    import_results("itaco", src, data, tmp_path / "r")
    assert read_result(tmp_path / "r" / "a").articulation.joint.type == joint_type


def test_itaco_without_a_loss_is_a_declared_failure(data, tmp_path, src):
    itaco(src / "a", losses=(None, None))
    report = import_results("itaco", src, data, tmp_path / "r")
    assert report.failures == ("a",) and isinstance(read_result(tmp_path / "r" / "a"), Failure)


# ---- methods of two states


def test_paris_without_the_objects_pose_is_refused(data, tmp_path, src):
    paris(src / "a")
    with pytest.raises(FreeArtError, match=r"stands in the object's frame \(zup\).*--object-poses.*--frame camera"):
        import_results("paris", src, data, tmp_path / "r")
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize("known, note", [(True, "joint type is an input"), (False, "the import chose")])
@pytest.mark.parametrize("name", "ab")
def test_digitaltwinart_notes_who_chose_the_type_and_takes_the_last_step(tmp_path, src, run, name, known, note):
    digitaltwinart(src / name, name, known=known)
    write_json(src / name / "results" / "step_0000500" / "init_motion.json", [])
    assert run("digitaltwinart", name).values["axis"] < 0.01
    assert note in notes_of(tmp_path / "r", name)


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


def test_rsrd_needs_the_parts_gaussians(tmp_path, src, run):
    rsrd(src / "a")
    (src / "a" / "part_1.ply").unlink()
    assert_refused(r"part_1.ply is missing: .* export the Gaussians", run, "rsrd")
    assert not (tmp_path / "r").exists()


def test_one_run_gives_the_reference_parts_poses_and_no_joint(tmp_path, src, run):
    truth = truth_of()
    tracked(src / "a", truth.Ts_camera_reference, truth.articulation.reference, 4)
    row = run("bundlesdf")
    assert row.values["pose_rotation"] < 0.01 and row.values["pose_translation"] < 0.01
    assert lacks(tmp_path / "r") == ("joint", "states", "masks", "meshes", "renders")
    assert row.values["axis"] is None and row.values["joint_type"] is None
    assert "no joint" in notes_of(tmp_path / "r")


def test_runs_without_a_common_frame_and_too_many_runs(src, run):
    truth = truth_of()
    tracked(src / "a" / "x", truth.Ts_camera_reference[:4], truth.articulation.reference, 4)
    tracked(src / "a" / "y", truth.Ts_camera_moving[:4], truth.articulation.moving, 4)
    for path in (src / "a" / "y" / "ob_in_cam").iterdir():
        path.rename(path.with_stem(f"{int(path.stem) + 8:04d}"))
    assert_refused("no frame in common", run, "bundlesdf")
    tracked(src / "a" / "z", truth.Ts_camera_moving, truth.articulation.moving, 4)
    assert_refused("3 runs", run, "bundlesdf")


def test_a_rotation_that_is_none_is_refused(src, run):
    runs_of(src / "a", of=lambda Ts: 2 * Ts)
    assert_refused("not a rigid pose", run, "bundlesdf")


def test_a_third_part_joins_the_one_that_it_does_not_move_against(tmp_path, src, run):
    rsrd(src / "a")
    path = src / "a" / "keyframes.txt"
    tracks = json.loads(path.read_text())
    for row in tracks["part_deltas"]:
        row.append(row[1])
    path.write_text(json.dumps(tracks))
    (src / "a" / "part_2.ply").write_bytes((src / "a" / "part_1.ply").read_bytes())
    run("rsrd")
    parts = read_result(tmp_path / "r" / "a").articulation
    assert len(parts.moving.faces) == 6000 and len(parts.reference.faces) == 4000


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
        (["x"], None),
    ],
)
def test_names_of_frames(stems, expected):
    if expected is None:
        assert_refused("here", number_frames, stems, 3, "here")
    else:
        assert number_frames(stems, 3, "here")[0].tolist() == expected


# ---- the fitted joint


def measured(kind, rng, *, span, noise_m=0.0, noise_deg=0.0, wild=0.0, n=60):
    """Poses of a part 0.2 m across against another, by a joint 0.15 m from its middle, and what is true of it."""
    axis, centre = rng.normal(size=3), rng.normal(size=3) * 0.1
    axis /= np.linalg.norm(axis)
    home = se3.exp_se3(rng.normal(size=6))
    away = np.cross(axis, rng.normal(size=3))
    joint = Joint("j", kind, axis, se3.transform(home, centre) + 0.15 * away / np.linalg.norm(away), -9, 9)
    states = span * (0.5 - 0.5 * np.cos(np.linspace(0, 0.9 * np.pi, n)))
    middle = se3.pose(np.eye(3), centre)
    noise = rng.normal(size=(n, 6)) * ([noise_m] * 3 + [np.radians(noise_deg)] * 3)
    motion = joint.transform(states) @ home @ middle @ se3.exp_se3(noise) @ se3.inverse(middle)
    lost = rng.random(n) < wild
    motion[lost] = motion[lost] @ se3.exp_se3(rng.normal(size=(int(lost.sum()), 6)) * [0.2, 0.2, 0.2, 0.5, 0.5, 0.5])
    return joint, states, motion, centre


@pytest.mark.parametrize("kind, span", [("revolute", 1.2), ("revolute", 0.3), ("prismatic", 0.3), ("prismatic", 0.05)])
def test_a_joint_of_exact_poses_is_exact(kind, span):
    joint, states, motion, centre = measured(kind, np.random.default_rng(1), span=span)
    fit = fit_joint("j", motion, centre, 0.2)
    assert fit.joint.type == kind and fit.residual < 1e-6 and fit.other_residual > 100 * max(fit.residual, 1e-6)
    assert fit.joint.axis == pytest.approx(joint.axis, abs=1e-5)  # states rise, as the true ones do
    assert fit.states - fit.states[0] == pytest.approx(states - states[0], abs=1e-5)
    if kind == "revolute":
        assert np.linalg.norm(np.cross(fit.joint.pivot - joint.pivot, joint.axis)) < 1e-5
    carried = fit.joint.transform(fit.states) @ fit.T_reference_moving
    assert carried == pytest.approx(motion, abs=1e-5)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind, span, degrees", [("revolute", 1.2, 2), ("revolute", 0.4, 5), ("prismatic", 0.3, 1.5)])
def test_a_joint_of_noisy_poses_with_some_of_them_lost(kind, span, degrees, seed):
    joint, states, motion, centre = measured(
        kind, np.random.default_rng(seed), span=span, noise_m=0.003, noise_deg=1, wild=0.05
    )
    fit = fit_joint("j", motion, centre, 0.2)
    assert fit.joint.type == kind
    assert np.degrees(np.arccos(min(1, fit.joint.axis @ joint.axis))) < degrees
    off = fit.states - states
    assert np.median(np.abs(off - np.median(off))) < (0.02 if kind == "revolute" else 0.004)
    if kind == "revolute":
        assert np.linalg.norm(np.cross(fit.joint.pivot - joint.pivot, joint.axis)) < 0.015


def test_parts_that_do_not_move_have_no_joint():
    still = np.repeat(rigid(0)[None], 10, 0)
    assert_refused("does not move", fit_joint, "j", still, np.zeros(3), 0.2)
