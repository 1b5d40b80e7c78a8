"""Files round trip, are written whole or not at all, and a broken one is one clear line."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mutations import MUTATED, mutated_arrays, mutated_bytes, mutated_json, reads_or_refuses
from refusal import assert_refused

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.asset import Asset
from freeart21.camera import Camera
from freeart21.effects import CoulombFriction, ReturnSpring, ViscousDamping
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked, places
from freeart21.files.asset import read_asset, write_asset_json
from freeart21.files.benchmark import read_benchmark, write_benchmark
from freeart21.files.mesh_file import read_ply, write_ply
from freeart21.files.result import Method, read_method, read_result, write_method, write_result
from freeart21.files.sequence import encode_depth, read_sequence, write_sequence
from freeart21.files.truth import read_truth, write_truth
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Alternative, Failure, Reconstruction, Trust
from freeart21.recording import Frame, Query, Recording
from freeart21.truth import Truth

N, WIDTH, HEIGHT, SCALE = 4, 32, 24, 1e-4
RNG = np.random.default_rng(0)
CAMERA = Camera.from_fov(WIDTH, HEIGHT, 0.6)
JOINT = Joint("hinge", "revolute", np.array([0, 0.6, 0.8]), np.array([0.1, 0.2, 0.3]), -0.5, 1.5)
TRIANGLES = Mesh(RNG.standard_normal((9, 3)), np.arange(9).reshape(3, 3), RNG.integers(0, 255, (9, 3)))
POSES = se3.exp_se3(RNG.standard_normal((N, 6)))
STATES = np.linspace(-0.4, 1.2, N)


def make_recording() -> Recording:
    frames = [
        Frame(
            RNG.integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8),
            (SCALE * RNG.integers(0, 65535, (HEIGHT, WIDTH))).astype(np.float32),
            RNG.random((HEIGHT, WIDTH)) > 0.5,
        )
        for _ in range(N)
    ]
    queries = (Query(0, 2, POSES[1]), Query(3, 0, np.eye(4)))
    return Recording(CAMERA, np.arange(N) / 30, frames.__getitem__, queries, "CC-BY-4.0")


def make_truth() -> Truth:
    masks = RNG.integers(0, 3, (N, HEIGHT, WIDTH), np.uint8)
    flags = (np.array([True, False, True]), np.array([True, True, False]))
    return Truth(
        Articulation(JOINT, TRIANGLES, TRIANGLES),
        STATES,
        POSES,
        POSES @ JOINT.transform(STATES),
        RNG.integers(0, 99, (N, 2)),
        flags,
        flags[::-1],
        masks.__getitem__,
        lambda i: np.stack([masks[i]] * 3, -1),
        lambda i: masks[i] > 0,
        {"seed": 7},
    )


def make_reconstruction() -> Reconstruction:
    std = np.array([0.1, np.nan, 0.2, 0.3])
    return Reconstruction(
        Articulation(JOINT, TRIANGLES, TRIANGLES),
        STATES,
        POSES,
        POSES @ JOINT.transform(STATES),
        RNG.integers(0, 3, (N, HEIGHT, WIDTH), np.uint8),
        RNG.random((N, 2)) > 0.5,
        std,
        np.broadcast_to(np.eye(6), (N, 2, 6, 6)),
        {"tracks": 1.5},
    )


@pytest.fixture
def sequence(tmp_path):
    write_sequence(tmp_path / "seq", make_recording(), SCALE)
    return tmp_path / "seq"


@pytest.fixture
def result(tmp_path):
    write_result(
        tmp_path / "ours" / "seq", make_reconstruction(), {"window": 8}, [np.full((HEIGHT, WIDTH, 3), 9, np.uint8)]
    )
    return tmp_path / "ours" / "seq"


def render(result: Path, folder: str = "renders") -> np.ndarray:
    return checked.read_rgb(result / folder / "00000.png")


def edit(path: Path, **changes) -> None:
    data = json.loads(path.read_text())
    data.update(changes)
    path.write_text(json.dumps(data))


def test_a_sequence_round_trips_to_half_a_depth_unit_and_has_no_other_files(tmp_path):
    before = make_recording()
    write_sequence(tmp_path / "seq", before, SCALE)
    after = read_sequence(tmp_path / "seq")
    np.testing.assert_array_equal(after.camera.K, CAMERA.K)
    assert len(after) == N and after.licence == "CC-BY-4.0" and after.queries[0].state_of_frame == 2
    np.testing.assert_allclose(after.queries[0].T_newcam_cam, POSES[1], atol=1e-12)
    for a, b in zip(before.frames(), after.frames(), strict=True):
        np.testing.assert_array_equal(a.rgb, b.rgb)
        np.testing.assert_array_equal(a.mask, b.mask)
        np.testing.assert_allclose(a.depth, b.depth, atol=0.51 * SCALE)
        np.testing.assert_array_equal(a.depth == 0, b.depth == 0)
    header = json.loads((tmp_path / "seq" / "sequence.json").read_text())
    assert set(header) == {"schema", "camera", "depth_scale", "times_s", "licence"}
    entries = {p.name for p in (tmp_path / "seq").iterdir()}
    assert entries == {"sequence.json", "queries.json", "rgb", "depth", "mask"}


def test_depth_out_of_range_is_no_depth(sequence):
    depth = np.array([[0.0, 1e-9, 0.5, 6.5534, 6.5535, 7.0]])
    np.testing.assert_array_equal(encode_depth(depth, SCALE), [[0, 0, 5000, 65534, 0, 0]])
    path = sequence / "depth" / "00000.png"
    units = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    units[:2], units[2:4] = 65535, 65534
    cv2.imwrite(str(path), units)
    read = read_sequence(sequence).frame(0).depth
    assert (read[:2] == 0).all() and read[2:4] == pytest.approx(6.5534)


def test_a_folder_that_is_not_a_sequence_and_wrong_frames_are_named(sequence, tmp_path):
    assert_refused("is not a sequence: it has no sequence.json", read_sequence, tmp_path)
    assert_refused("is not a folder", read_sequence, tmp_path / "nothing")
    cv2.imwrite(str(sequence / "depth" / "00001.png"), np.ones((HEIGHT, WIDTH + 2), np.uint16))
    assert_refused("frame 1: depth is 34 x 24, expected 32 x 24", lambda: read_sequence(sequence).frame(1))
    (sequence / "depth" / "00002.png").unlink()
    assert_refused("frame 2 is missing: no depth/00002.png, expected 4 frames", read_sequence, sequence)


def test_a_truth_round_trips(tmp_path):
    before = make_truth()
    write_truth(tmp_path / "truth", before, n_queries=2)
    after = read_truth(tmp_path / "truth")
    np.testing.assert_allclose(after.Ts_camera_moving, before.Ts_camera_moving, atol=1e-15)
    np.testing.assert_array_equal(after.states, before.states)
    np.testing.assert_array_equal(after.outer[0], before.outer[0])
    np.testing.assert_array_equal(after.visible[1], before.visible[1])
    np.testing.assert_array_equal(after.part_mask(3), before.part_mask(3))
    np.testing.assert_array_equal(after.query_rgb(1), before.query_rgb(1))
    np.testing.assert_array_equal(after.query_mask(1), before.query_mask(1))
    assert after.source == {"seed": 7} and after.diagonal == pytest.approx(before.diagonal, abs=1e-15)


def test_a_result_round_trips(result):
    after = read_result(result)
    assert isinstance(after, Reconstruction)
    assert after.articulation.joint.type == "revolute" and after.seconds == {"tracks": 1.5}
    np.testing.assert_allclose(after.Ts_camera_reference, POSES, atol=1e-15)
    np.testing.assert_array_equal(after.articulation.moving.vertices, TRIANGLES.vertices)
    assert np.isnan(after.state_std[1]) and after.state_std[3] == 0.3
    np.testing.assert_array_equal(render(result), np.full((HEIGHT, WIDTH, 3), 9))


def test_what_a_result_says_of_itself_round_trips(result):
    before = read_result(result)
    assert before.trust is None and before.axis_std is None and before.pivot_std is None, "methods need not say"
    assert not (result / "renders_other").exists()
    trust = Trust("doubtful", ("it jumps", "it \u2013 hides"))
    slide = Joint("slide", "prismatic", [0, 0, 1], [0, 0.1, 0], 0.0, 0.3)
    rival = Alternative(slide, np.linspace(0, 0.3, len(before)), 0.02)
    answer = replace(before, trust=trust, axis_std=0.01, alternatives=(rival,))
    views = [np.full((HEIGHT, WIDTH, 3), k, np.uint8) for k in (1, 2)]
    write_result(result, answer, renders=views[:1], renders_other=views[1:])
    after = read_result(result)
    assert after.trust == trust and after.axis_std == 0.01 and after.pivot_std is None
    assert before.alternatives == () and len(after.alternatives) == 1
    (other,) = after.alternatives
    assert (other.joint.type, other.joint.upper, other.cost_difference) == ("prismatic", 0.3, 0.02)
    np.testing.assert_array_equal(other.joint.pivot, slide.pivot)
    np.testing.assert_array_equal(other.states, rival.states)
    written = json.loads((result / "prediction.json").read_text())
    assert written["trust"] == {"verdict": "doubtful", "reasons": list(trust.reasons)}
    assert written["joint_std"] == {"axis_rad": 0.01, "pivot_m": None}
    assert render(result).max() == 1 and render(result, "renders_other").max() == 2


def test_an_answer_cannot_be_sound_for_reasons_of_doubt():
    assert_refused("'sound' with 1 reasons", Trust, "sound", ("why",))
    assert_refused("expected sound or doubtful", Trust, "certain")


def test_a_failure_round_trips_and_replaces_an_older_result(result):
    write_result(result, Failure("segmentation", "only one motion", {"tracks": 2.0}))
    assert read_result(result) == Failure("segmentation", "only one motion", {"tracks": 2.0})
    assert [p.name for p in result.iterdir()] == ["prediction.json"]
    assert [p.name for p in result.parent.iterdir()] == ["seq"]


def test_a_mirrored_pose_is_refused(result):
    mirrored = POSES * np.where(np.arange(4) == 0, -1, 1)
    np.savez_compressed(result / "poses.npz", T_camera_reference=POSES, T_camera_moving=mirrored)
    assert_refused(r"Ts_camera_moving\[0\] is not a rigid pose", read_result, result)


def test_a_ply_round_trips_with_flags_and_without_colours(tmp_path):
    flags = {"outer": np.array([True, False, True])}
    write_ply(tmp_path / "a.ply", replace(TRIANGLES, colours=None), flags)
    mesh, read = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(mesh.vertices, TRIANGLES.vertices)
    np.testing.assert_array_equal(read["outer"], flags["outer"])
    assert mesh.colours is None


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    with pytest.raises(RuntimeError), atomic.new_folder(tmp_path / "a") as aside:
        (aside / "half").write_text("x")
        raise RuntimeError
    assert not list(tmp_path.iterdir())


def test_an_old_folder_survives_a_failed_replacement(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "asset.json").write_text('{"schema": "freeart21/asset/1"}')
    with pytest.raises(RuntimeError), atomic.new_folder(tmp_path / "a", places.ASSET):
        raise RuntimeError
    assert (tmp_path / "a" / "asset.json").is_file() and len(list(tmp_path.iterdir())) == 1
    with pytest.raises(FreeArtError, match="exists"), atomic.new_folder(tmp_path / "a"):
        pass


def test_infinity_is_never_written_as_json(tmp_path):
    assert_refused("cannot write inf", atomic.write_json, tmp_path / "a.json", {"x": np.inf})
    assert not list(tmp_path.iterdir())


def test_a_benchmark_lists_every_file_with_its_hash(sequence, tmp_path):
    data = tmp_path / "data"
    (data / "sequences").mkdir(parents=True)
    sequence.rename(data / "sequences" / "seq")
    write_truth(data / "truth" / "seq", make_truth(), 2)
    write_benchmark(data, "mine", "1", "public")
    benchmark = read_benchmark(data)
    assert benchmark.sequences == ("seq",) and benchmark.truth("seq").is_dir()
    hashes = json.loads((data / "benchmark.json").read_text())["sha256"]
    files = {str(p.relative_to(data)) for p in data.rglob("*") if p.is_file()} - {"benchmark.json"}
    assert set(hashes) == files


def test_a_benchmark_cannot_name_a_path_outside(tmp_path):
    header = {"schema": "freeart21/benchmark/1", "name": "a", "version": "1", "split": "public"}
    atomic.write_json(tmp_path / "benchmark.json", {**header, "sequences": ["../../secret"]})
    assert_refused("not a list of folder names", read_benchmark, tmp_path)


def test_a_method_round_trips_and_has_a_name_without_a_file(tmp_path):
    assert read_method(tmp_path).name == tmp_path.name
    write_method(tmp_path, Method("ours", "v1", {"a": 1}, "2 cores"))
    assert read_method(tmp_path) == Method("ours", "v1", {"a": 1}, "2 cores")


URDF = """<robot name="box"><link name="base"/><link name="lid"/><link name="knob"/>
<joint name="hinge" type="revolute"><parent link="base"/><child link="lid"/><axis xyz="0 0 1"/>
<limit lower="-0.0" upper="1.5" effort="10" velocity="10"/><dynamics damping="0.03" friction="0.2"/></joint>
<joint name="slide" type="prismatic"><parent link="lid"/><child link="knob"/><limit lower="0.1" upper="0.2"/></joint>
</robot>"""


@pytest.fixture
def urdf(tmp_path):
    (tmp_path / "asset").mkdir()
    path = tmp_path / "asset" / "box.urdf"
    path.write_text(URDF)
    return path


def test_urdf_dynamics_mean_damping_and_coulomb_friction(urdf):
    asset = read_asset(urdf, "hinge")
    assert asset.effects == {"hinge": (ViscousDamping(0.03), CoulombFriction(0.2))}
    assert asset.held == {"slide": 0.1}  # zero lies outside its limits


def test_an_asset_round_trips_with_effects_that_urdf_cannot_say(urdf):
    effects = {"hinge": (ViscousDamping(0.03), CoulombFriction(0.2), ReturnSpring(1.5, 0.2))}
    before = Asset(urdf, "hinge", "base", "lid", POSES[0], 0.25, effects, {"slide": 0.1}, {"method": "ours"})
    write_asset_json(urdf.parent, before)
    after = read_asset(urdf.parent)
    assert (after.joint, after.effects, after.held, after.state_zero) == ("hinge", effects, {"slide": 0.1}, 0.25)
    np.testing.assert_allclose(after.T_canonical_reference, POSES[0], atol=1e-12)


def test_an_unclear_choice_of_joint_lists_them(urdf):
    assert_refused(r"no joint was named; movable joints: hinge \(revolute .* deg\), slide \(pris", read_asset, urdf)
    assert_refused(r"no movable joint 'lid'; movable joints: hinge \(.*\), slide \(", read_asset, urdf, "lid")


def test_an_asset_cannot_point_out_of_its_folder(urdf):
    write_asset_json(urdf.parent, Asset(urdf, "hinge", "base", "lid", effects=read_asset(urdf, "hinge").effects))
    edit(urdf.parent / "asset.json", urdf="../../etc/passwd")
    assert_refused("leads out of the folder", read_asset, urdf.parent)


# --- nearly valid files -----------------------------------------------------------------------------------------------


@settings(MUTATED, max_examples=90)
@given(data=st.data())
def test_a_sequence_or_result_with_a_wrong_field_is_read_or_one_line(tmp_path, data):
    if not (tmp_path / "ours").is_dir():
        write_sequence(tmp_path / "seq", make_recording(), SCALE)
        rival = Alternative(JOINT, STATES, 0.02)
        doubts = {"trust": Trust("doubtful", ("it jumps",)), "axis_std": 0.01, "alternatives": (rival,)}
        write_result(tmp_path / "ours", replace(make_reconstruction(), **doubts))
    file = data.draw(st.sampled_from(("seq/sequence.json", "seq/queries.json", "ours/prediction.json")))
    path, read = tmp_path / file, read_result if file.startswith("ours") else read_sequence
    good = path.read_text()
    path.write_text(json.dumps(data.draw(mutated_json(json.loads(good)))))
    try:
        line = reads_or_refuses(read, path.parent)
        assert not line or path.parent.name in line
    finally:
        path.write_text(good)


@settings(MUTATED, max_examples=40)
@given(data=st.data())
def test_poses_and_meshes_that_are_nearly_right_are_read_or_one_line(tmp_path, data):
    if not (tmp_path / "ours").is_dir():
        write_result(tmp_path / "ours", make_reconstruction())
    poses, mesh = tmp_path / "ours/poses.npz", tmp_path / "ours/parts/moving.ply"
    before = poses.read_bytes(), mesh.read_bytes()
    if data.draw(st.booleans()):
        with np.load(poses) as stored:
            np.savez_compressed(poses, **data.draw(mutated_arrays(dict(stored))))
    elif data.draw(st.booleans()):
        poses.write_bytes(data.draw(mutated_bytes(before[0])))
    else:
        mesh.write_bytes(data.draw(mutated_bytes(before[1])))
    reads_or_refuses(read_result, tmp_path / "ours")
    poses.write_bytes(before[0]), mesh.write_bytes(before[1])
