"""Any track, any object: takes replayed as they were taken, and URDFs of anybody recorded."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from another_python import ROOT
from hypothesis import given
from hypothesis import strategies as st
from mutations import MUTATED, mutated_arrays, mutated_json, reads_or_refuses

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files.hashes import file_sha256
from freeart21.files.sequence import read_sequence
from freeart21.files.take import read_take, write_take
from freeart21.files.truth import read_truth
from freeart21.formats.captured import ARCTIC_SIZES_M, read_track
from freeart21.joint import Joint
from freeart21.mesh import Mesh, bounding_diagonal
from generator.commands import RecordOptions
from generator.commands import record as run_record
from generator.dataset import plan_jobs
from generator.golden import verify_deep
from generator.motion import track
from generator.motion.body import UPRIGHT, Body
from generator.motion.framing import image_extent
from generator.motion.plan import PRESETS
from generator.object_source import find_object
from generator.recorder import RecordSettings, record
from generator.scene import Scene
from generator.session import plan_recording
from generator.urdf_object import load_urdf

SHARED = ROOT.parent / "shared"
SMALL = RecordSettings(frames=5, width=96, height=64, shader="trivial", queries=1, edge=0.5)
AXIS = np.array([0.6, 0.0, 0.8])

needs_objects = pytest.mark.skipif(not (SHARED / "urdf_objects").is_dir(), reason="the URDFs are not on this machine")


def moved(times: np.ndarray) -> np.ndarray:
    """Poses (n, 4, 4) of a steady turn and a straight way: between samples both are known."""
    far = np.array([0.01, -0.02, 0.6]) + times[:, None] * [0.02, 0.01, 0.03]
    return se3.pose(se3.exp_so3((0.3 + 0.9 * times)[:, None] * AXIS) @ se3.exp_so3([0.3, 0.5, -0.2]), far)


def bent(times: np.ndarray) -> np.ndarray:
    """States that move most in the last second."""
    return np.where(times < 1, 0.1, 0.1 + 0.4 * (times - 1))


def taken(path: Path, rate: float = 100.0, poses: str = "first", joint_type: str = "revolute", seconds: float = 2.0):
    times = np.arange(round(seconds * rate) + 1) / rate
    write_take(path, "a test", poses, joint_type, zip(5 + times, moved(times), bent(times), strict=True))
    return path


def arctic(path: Path, q: np.ndarray, turn: float = 0.0) -> Path:
    """A track of ARCTIC: joint angles `q`, turned by `turn` a row about the world's z and lifted by 1 mm a row."""
    rows = np.zeros((len(q), 7), np.float32)
    rows[:, 0], rows[:, 3], rows[:, 6] = q, turn * np.arange(len(q)), np.arange(len(q))
    np.save(path, rows)
    return path


# --- samples ----------------------------------------------------------------------------------------------------------


def test_a_take_is_read_as_it_was_written(tmp_path: Path) -> None:
    take = read_track(taken(tmp_path / "a.txt"))
    times = np.arange(201) / 100
    np.testing.assert_allclose(take.Ts, moved(times), atol=1e-12)
    np.testing.assert_allclose(take.times - 5, times, atol=1e-12)
    np.testing.assert_array_equal(take.states, bent(times))
    assert (take.poses, take.joint_type, take.device, take.name) == ("first", "revolute", "a test", "a.txt")
    assert take.sha256 == file_sha256(tmp_path / "a.txt")


def test_fewer_frames_are_those_over_which_the_joint_moves_most(tmp_path: Path) -> None:
    stretch = track.resample_take(read_take(taken(tmp_path / "a.txt")), 30.0, 31)
    assert stretch.begins_s == 1.0
    np.testing.assert_allclose(stretch.states, bent(1 + np.arange(31) / 30), atol=1e-12)
    np.testing.assert_allclose(stretch.Ts, moved(1 + np.arange(31) / 30), atol=1e-9)
    with pytest.raises(FreeArtError, match="lasts 61 frames at 30 a second, fewer than 62"):
        track.resample_take(read_take(tmp_path / "a.txt"), 30.0, 62)


def test_a_track_of_arctic_is_recognised_by_content_and_seen_by_a_level_camera(tmp_path: Path) -> None:
    take = read_track(arctic(tmp_path / "a.npy", np.linspace(0, 1, 31), turn=0.02))
    assert (take.form, take.poses, take.times[-1]) == ("ARCTIC object track", "first", 1.0)
    (tmp_path / "a.npy").rename(tmp_path / "a.jsonl")
    assert read_track(tmp_path / "a.jsonl").sha256 == take.sha256
    np.testing.assert_allclose(take.Ts[-1, :3, 3], [0, -0.030, 0], atol=1e-6)  # lifted: up in the picture
    turn = take.Ts[-1, :3, :3] @ take.Ts[0, :3, :3].T
    np.testing.assert_allclose(se3.log_so3(turn), [0, -0.6, 0], atol=1e-6)  # about the upright axis; y is down


@MUTATED
@given(data=st.data())
def test_a_take_with_an_odd_field_is_read_or_refused_in_a_line(tmp_path: Path, data: st.DataObject) -> None:
    lines = taken(tmp_path / "a.txt", rate=2.0).read_text().splitlines()
    k = data.draw(st.integers(0, len(lines) - 1))
    lines[k] = json.dumps(data.draw(mutated_json(json.loads(lines[k]))))
    (tmp_path / "a.txt").write_text("\n".join(lines[: data.draw(st.integers(0, len(lines)))]))
    reads_or_refuses(read_track, tmp_path / "a.txt")


@MUTATED
@given(arrays=mutated_arrays({"a": np.zeros((40, 7), np.float32)}))
def test_an_odd_array_is_read_or_refused_in_a_line(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    np.save(tmp_path / "a.npy", arrays.get("a", np.zeros(0)))
    reads_or_refuses(read_track, tmp_path / "a.npy")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("take/1", "take/2", "has schema 'freeart21/take/2', expected 'freeart21/take/1'"),
        ("rad", "deg", "'units' is .*expected .*'rad'"),
        ('"time": 6.0', '"time": "now"', "line 4: 'time' is now, expected a finite number"),
        ('"time": 7.0', '"time": 9000', "a.txt lasts 8995 s, expected at most 3333 s"),
    ],
)
def test_what_is_wrong_with_a_take_is_said_in_a_line(tmp_path: Path, old: str, new: str, expected: str) -> None:
    text = taken(tmp_path / "a.txt", rate=2.0).read_text()
    assert old in text
    (tmp_path / "a.txt").write_text(text.replace(old, new))
    with pytest.raises(FreeArtError, match=expected):
        track.count_frames(read_track(tmp_path / "a.txt"), 30.0)


def test_a_header_that_promises_more_and_objects_are_not_believed(tmp_path: Path) -> None:
    whole = arctic(tmp_path / "a.npy", np.zeros(40)).read_bytes()
    (tmp_path / "a.npy").write_bytes(whole.replace(b"(40, 7), }      ", b"(4000000000, 7)}"))
    with pytest.raises(FreeArtError, match="is not a readable array"):
        read_track(tmp_path / "a.npy")
    np.save(tmp_path / "b.npy", np.array([{}], object), allow_pickle=True)
    with pytest.raises(FreeArtError, match="is not a readable array"):
        read_track(tmp_path / "b.npy")


# --- before the camera ------------------------------------------------------------------------------------------------


def _body(joint_type: str = "revolute", upper: float = 1.0) -> Body:
    boxes = [trimesh.creation.box((0.1, 0.1, 0.04)), trimesh.creation.box((0.1, 0.1, 0.02))]
    meshes = [Mesh(np.add(b.vertices, [0, 0, z]), np.asarray(b.faces)) for b, z in zip(boxes, (0, 0.03), strict=True)]
    joint = Joint("lid", joint_type, np.array([1.0, 0, 0]), np.array([0, 0.05, 0.02]), 0.0, upper)  # type: ignore[arg-type]
    return Body.of((meshes[0], meshes[1]), joint)


def test_states_in_reach_stay_as_they_are_and_others_are_scaled(tmp_path: Path) -> None:
    take = read_take(taken(tmp_path / "a.txt"))  # 0.1 to 0.5 rad
    states, changes = track.fit_states(take.states, take, _body(upper=0.5))
    assert np.array_equal(states, take.states) and changes == {"states": "as taken"}
    states, changes = track.fit_states(take.states, take, _body(upper=0.4))
    assert states.min() == 0 and states.max() == 0.4
    np.testing.assert_allclose(states, (take.states - 0.1) / 0.4 * 0.4, atol=1e-12)
    assert (changes["states"], changes["from"][0], changes["to"]) == ("scaled", "revolute", ["revolute", 0.0, 0.4])
    states, changes = track.fit_states(take.states, take, _body("prismatic", 0.02))
    assert states.max() == pytest.approx(0.02) and changes["to"] == ["prismatic", 0.0, 0.02]
    still = dataclasses.replace(take, states=np.full(201, 0.3))
    assert track.fit_states(still.states, still, _body())[1] == {"states": "as taken"}
    with pytest.raises(FreeArtError, match="stands still at 0.3, where joint 'lid' cannot be: revolute, 0 to 0.2"):
        track.fit_states(still.states, still, _body(upper=0.2))


def test_the_way_is_as_long_in_sizes_of_the_object_as_it_was_where_the_take_tells_that(tmp_path: Path) -> None:
    low, high = ARCTIC_SIZES_M
    theirs = read_track(arctic(tmp_path / "a.npy", np.linspace(0, 1, 31)))
    for diagonal, scale in ((low, 1.0), (0.3, 1.0), (high, 1.0), (low / 4, 0.25), (3 * high, 3.0)):
        assert track.scale_translation(theirs, diagonal)[0] == pytest.approx(scale)
    assert track.scale_translation(theirs, 0.06)[1] == {"carry": 0.25, "size": 0.06, "taken_with": low}
    ours = read_take(taken(tmp_path / "a.txt"))
    assert track.scale_translation(ours, 0.06) == (1.0, {"carry": 1.0})
    stays = dataclasses.replace(ours, poses="camera")
    assert track.scale_translation(stays, 0.06) == (1.0, {})
    body, camera = _body(), Camera.from_fov(320, 180, 0.7)
    stretch = track.resample_take(ours, 30.0, 61)
    way = {}
    for carry in (0.0, 0.5, 1.0):
        Ts = track.object_poses(body, stretch, 0 * stretch.states, ours, UPRIGHT, camera, PRESETS["handheld"], carry)
        way[carry] = Ts[:, :3, 3] - Ts[0, :3, 3]
        np.testing.assert_allclose(way[carry], carry * (stretch.Ts[:, :3, 3] - stretch.Ts[0, :3, 3]), atol=1e-9)
    assert np.abs(way[1.0]).max() > 0.01


def test_changes_of_a_take_are_reported_and_stored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = np.zeros((12, 7), np.float32)
    rows[:, 0], rows[:, 4] = np.linspace(0, 1, 12), 20 * np.arange(12)  # 22 cm to the side
    np.save(tmp_path / "a.npy", rows)
    small = RecordSettings(width=96, height=64, queries=0, shader="trivial")
    options = RecordOptions(("flip_cap_usb",), tmp_path / "data", motion=f"track:{tmp_path / 'a.npy'}", settings=small)
    run_record(options)
    truth = read_truth(tmp_path / "data" / "truth" / "flip_cap_usb-s0")
    expected = truth.source["track"]
    assert expected["carry"] == pytest.approx(expected["size"] / expected["taken_with"]) and expected["carry"] < 0.5
    Ts = truth.Ts_camera_reference if "link_0" not in truth.source["reference_links"] else truth.Ts_camera_moving
    assert np.linalg.norm(Ts[-1, :3, 3] - Ts[0, :3, 3]) == pytest.approx(0.22 * expected["carry"], rel=1e-4)
    out, err = capsys.readouterr()
    assert out.strip().endswith("flip_cap_usb-s0")
    assert f"a.npy: its translation scaled by {expected['carry']:.2g} (an object of" in err and err.count("\n") == 1
    with pytest.raises(FreeArtError, match="exists with edge 0.02, not 1"):
        run_record(dataclasses.replace(options, settings=dataclasses.replace(small, edge=1.0)))


@pytest.mark.parametrize("poses", ["first", "camera"])
def test_the_truth_moves_as_the_take_does(tmp_path: Path, poses: str) -> None:
    take = taken(tmp_path / "a.txt", 50.0, poses)
    data = tmp_path / "data"
    sequence = record("flip_lighter", data, dataclasses.replace(SMALL, motion="track", track=take))
    truth = read_truth(data / "truth" / sequence)
    begins = 1.0  # the first five frames over which the joint moves as much as over any
    want = moved(begins + np.arange(5) / 30)
    got = truth.Ts_camera_reference
    if "link_0" in truth.source["reference_links"]:  # the lid; the take moves the object's frame, the parent's side
        got = truth.Ts_camera_moving
    if poses == "camera":
        np.testing.assert_allclose(got, want, atol=1e-6)
    else:
        turns = got[:, :3, :3] @ got[0, :3, :3].T
        np.testing.assert_allclose(turns, want[:, :3, :3] @ want[0, :3, :3].T, atol=1e-6)
        np.testing.assert_allclose(got[:, :3, 3] - got[0, :3, 3], want[:, :3, 3] - want[0, :3, 3], atol=1e-6)
    np.testing.assert_allclose(truth.states, bent(begins + np.arange(5) / 30), atol=1e-6)
    expected = truth.source["track"]
    assert expected["name"] == "a.txt" and expected["sha256"] == file_sha256(take) and expected["begins_s"] == begins
    assert truth.source["settings"]["track"] == {"name": "a.txt", "sha256": expected["sha256"]}
    assert str(tmp_path) not in (data / "truth" / sequence / "truth.json").read_text(), "no places of this machine"
    recording = read_sequence(data / "sequences" / sequence)
    assert all(recording.frame(i).mask.any() for i in range(5))
    assert record("flip_lighter", data, dataclasses.replace(SMALL, motion="track", track=take)) == sequence
    taken(take, 40.0, poses)
    with pytest.raises(FreeArtError, match="exists with track"):
        record("flip_lighter", data, dataclasses.replace(SMALL, motion="track", track=take))


def test_a_take_of_one_object_is_replayed_on_all_others_and_fills_the_picture(tmp_path: Path) -> None:
    """Of the size that it tells: it stands as it is on that one, and as much nearer as others are smaller."""
    times, camera = np.arange(31) / 30, Camera.from_fov(320, 180, 0.7)
    settings = dataclasses.replace(SMALL, motion="track", track=tmp_path / "a.txt", frames=31, width=320, height=180)
    fills, ways = {}, {}
    for k, name in enumerate(("stapler", "filing_cabinet", "cover_phone")):
        loaded = find_object(name, settings).load(tmp_path / name)
        meshes = loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()
        if k == 0:
            size = bounding_diagonal(*meshes)
            Ts = se3.pose(se3.exp_so3(times[:, None] * np.array([0.2, 1.1, 0.3])), np.array([0.0, 0, 3.0 * size]))
            samples = zip(times, Ts, 0.3 * times, strict=True)
            write_take(tmp_path / "a.txt", "mouse", "camera", "revolute", samples, size=size)
            assert read_track(tmp_path / "a.txt").size == size
        _, plan = plan_recording(loaded, settings)
        low, high = image_extent(plan.Ts_camera_object, plan.states, Body.of(meshes, loaded.joint), camera)
        assert (low >= 0).all() and (high <= [320, 180]).all()
        far = np.linalg.norm(plan.Ts_camera_object[:, :3, 3], axis=1).mean()
        ways[name] = far / bounding_diagonal(*meshes)
        fills[name] = np.linalg.norm(high - low, axis=1).mean()
        if k == 0:
            np.testing.assert_allclose(plan.Ts_camera_object, Ts, atol=1e-12)
        else:
            assert plan.source["carry"] == pytest.approx(far / (3.0 * size), rel=1e-6)
            np.testing.assert_allclose(plan.Ts_camera_object[:, :3, :3], Ts[:, :3, :3], atol=1e-12)
    assert all(3.0 - 1e-6 <= way < 4.5 for way in ways.values()), ways
    assert max(fills.values()) < 2 * min(fills.values()), fills


@pytest.mark.parametrize("path", sorted((ROOT / "examples" / "takes").glob("*.jsonl")), ids=lambda path: path.stem)
def test_the_example_takes_are_replayed_as_they_were_taken(path: Path, tmp_path: Path) -> None:
    take, name = read_track(path), path.stem.rpartition("-")[0]
    settings = dataclasses.replace(
        SMALL, motion="track", track=path, frames=track.count_frames(take, 30), width=320, height=180
    )
    _, plan = plan_recording(find_object(name, settings).load(tmp_path), settings)  # refuses what leaves the view
    assert plan.source["states"] == "as taken" and "carry" not in plan.source and take.size is not None
    assert (take.filter is not None) == (take.device == "headset")
    turned = np.arccos(
        np.clip((plan.Ts_camera_object[:, :3, :3] * plan.Ts_camera_object[0, :3, :3]).sum((1, 2)) / 2 - 0.5, -1, 1)
    )
    assert turned.max() > 0.5 and np.ptp(plan.states) > 0.3


def test_the_command_takes_the_take_s_length_by_default(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings: list[RecordSettings] = []
    monkeypatch.setattr(
        "generator.dataset.record_jobs", lambda out, jobs, *_: settings.extend(j.settings for j in jobs)
    )
    take = taken(tmp_path / "a.txt")
    for frames in (None, 40, 500):
        run_record(RecordOptions(("stapler",), tmp_path / "data", frames, motion=f"track:{take}"))
    assert [(s.frames, s.motion, s.track) for s in settings] == [(n, "track", take) for n in (61, 40, 61)]
    run_record(RecordOptions(("stapler",), tmp_path / "data"))
    assert (settings[-1].frames, settings[-1].motion, settings[-1].track) == (300, "tumble", None)
    for motion, expected in (
        ("track", "needs the file"),
        ("track:", "needs the file"),
        (f"track:{tmp_path / 'b'}", "b is missing"),
    ):
        with pytest.raises(FreeArtError, match=expected):
            run_record(RecordOptions(("stapler",), tmp_path / "data", motion=motion))


# --- any object -------------------------------------------------------------------------------------------------------

URDF = """<?xml version="1.0"?>
<robot name="case"><material name="red"><color rgba="0.8 0.1 0.1 1"/></material>
<link name="lid"><inertial><mass value="0.1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
 <visual><origin xyz="0 -0.05 0.01"/><geometry><mesh filename="package://case/lid.stl" scale="0.001 0.001 0.001"/>
 </geometry><material name="red"/></visual><collision><geometry><box size="1 1 1"/></geometry></collision></link>
<link name="box"><visual><geometry><mesh filename="box.obj"/></geometry></visual></link>
<joint name="hinge" type="revolute"><parent link="box"/><child link="lid"/><origin xyz="0 0.05 0.02"/>
 <axis xyz="1 0 0"/><limit lower="0" upper="1.5" effort="1" velocity="1"/>
 <dynamics damping="0.05" friction="0.01"/></joint>
<transmission name="t"/></robot>"""


@pytest.fixture
def case(tmp_path: Path) -> Path:
    folder = tmp_path / "case"
    folder.mkdir()
    trimesh.creation.box((100, 100, 20)).export(folder / "lid.stl")
    trimesh.creation.box((0.1, 0.1, 0.04)).export(folder / "box.obj")
    (folder / "case.urdf").write_text(URDF)
    return folder / "case.urdf"


def test_a_urdf_of_anybody_is_recorded_and_its_truth_is_what_is_seen(case: Path, tmp_path: Path) -> None:
    data = tmp_path / "data"
    take = arctic(tmp_path / "a.npy", np.linspace(0, 2, 12), turn=0.03)
    sequence = record(str(case), data, dataclasses.replace(SMALL, motion="track", track=take))
    assert sequence == "case-hinge-s0"
    truth = read_truth(data / "truth" / sequence)
    assert truth.states[-1] == pytest.approx(0.545, abs=1e-3) and truth.source["object_source"] == "urdf"
    assert truth.source["track"]["to"] == ["revolute", 0.0, 1.5]
    assert truth.source["settings"]["urdf"]["name"] == "case.urdf"
    assert str(tmp_path) not in (data / "truth" / sequence / "truth.json").read_text(), "no places of this machine"
    assert verify_deep(data) == []


def test_open_meshes_are_seen_from_both_sides(case: Path, tmp_path: Path) -> None:
    """A tray of one layer, its lid open: rays meet the inside of its walls, and so must the picture."""
    tray = trimesh.creation.box((0.1, 0.1, 0.04))
    tray.update_faces(tray.face_normals[:, 2] < 0.5)
    tray.export(case.parent / "box.obj")
    assert len(load_urdf(case).parent_side.surface.faces) == 20
    assert len(load_urdf(case).child_side.surface.faces) == 12
    take = arctic(tmp_path / "a.npy", np.linspace(0, 2, 12), turn=0.03)
    record(str(case), tmp_path / "data", dataclasses.replace(SMALL, motion="track", track=take))
    assert verify_deep(tmp_path / "data") == []


def _without(text: str, what: str) -> str:
    return re.sub(what, "", text, flags=re.S)


@pytest.mark.parametrize(
    ("change", "joint", "expected"),
    [
        (lambda t: t, "lid", r"no movable joint 'lid'; movable joints: hinge \(revolute 0..85.9 deg\)"),
        (lambda t: t.replace('"revolute"', '"fixed"'), None, "has no movable joint"),
        (
            lambda t: t.replace("box.obj", "bin.obj"),
            None,
            "names the mesh 'bin.obj', .*: looked for bin.obj in .*--root",
        ),
        (lambda t: t.replace('upper="1.5"', 'upper="0"'), None, r"joint 'hinge' cannot move: its limits are \[0, 0\]"),
    ],
)
def test_what_is_wrong_with_a_urdf_is_said_in_a_line(case: Path, change, joint: str | None, expected: str) -> None:
    case.write_text(change(URDF))
    with pytest.raises(FreeArtError, match=expected) as caught:
        plan_jobs([str(case)], dataclasses.replace(SMALL, joint=joint))
    assert str(case.parent) in str(caught.value) and "freeart21-" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_mimic_and_floating_joints_are_held_and_noted(case: Path, tmp_path: Path) -> None:
    more = """<link name="flap"><visual><geometry><mesh filename="box.obj"/></geometry></visual></link>
        <joint name="turns" type="continuous"><parent link="box"/><child link="flap"/><axis xyz="0 0 1"/>
        <mimic joint="hinge" multiplier="-2" offset="0.5"/></joint><link name="world"/>
        <joint name="free" type="floating"><parent link="world"/><child link="box"/></joint></robot>"""
    case.write_text(URDF.replace("</robot>", more).replace('upper="1.5"', 'upper="1e30"'))
    loaded = load_urdf(case)
    assert loaded.joint.name == "hinge" and loaded.asset.held == {"turns": 0.5}
    assert loaded.parent_side.links == ("box", "flap", "world")
    assert loaded.notes == (
        "joint 'free' is floating: it is held at its origin",
        "joint 'hinge' has no upper limit: it is moved from 0 to 6.283 rad",
        "joint 'turns' follows 'hinge' (mimic) and is held at 0.5: only two parts move",
    )
    Scene(loaded.asset.urdf, [side.links for side in loaded.sides], Camera.from_fov(64, 36, 0.6), 0.1, 9, "trivial")


@needs_objects
@pytest.mark.parametrize("name", ["laptop/laptop", "mixer/mixer", "ketchup/ketchup_derived_objbottom"])
def test_real_urdfs_are_loaded(name: str, tmp_path: Path) -> None:
    loaded = load_urdf(SHARED / "urdf_objects" / f"{name}.urdf", "rotation")
    size = np.ptp(np.concatenate([side.surface.vertices for side in loaded.sides]), axis=0)
    assert loaded.joint.type == "revolute" and 0.1 < np.linalg.norm(size) < 0.6
    assert all(len(side.surface.faces) > 100 for side in loaded.sides)
