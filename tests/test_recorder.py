"""The recorder: what the video shows is what the truth says, and the video says nothing of the truth."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files.hashes import file_sha256
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.recording import Recording
from freeart21.truth import Truth
from generator import partnet
from generator.golden import LEAST_PSNR, interior_pixels, render_again, verify_deep
from generator.model import Hinge, Link, Material, ObjectModel, Piece
from generator.partnet_writer import write_partnet
from generator.rays import Caster
from generator.recorder import RecordSettings, record
from generator.shapes import box

REAL = Path(__file__).resolve().parents[2] / "shared" / "partnet_mobility"
SETTINGS = RecordSettings(
    frames=10, seed=3, width=320, height=180, shader="trivial", queries=4, visible_every=1, edge=0.04
)
CASES = ["stapler", "drawer_unit", "small_root", *(["41083"] if (REAL / "41083").is_dir() else [])]


def _small_root(folder: Path) -> Path:
    """A toy whose moving link is larger than the rest: its reference part is the joint's child."""
    red, blue = (Material(n, c, "plastic", 1000) for n, c in (("red", (0.8, 0.2, 0.2)), ("blue", (0.2, 0.2, 0.8))))
    root = Link("heavy foot", (Piece("foot", box((0.1, 0.3, 0.1), (0.05, 0, 0)), blue),))
    board = Link(
        "hinge board",
        (Piece("board", box((0.02, 0.5, 0.6), (-0.01, 0.05, 0.35)), red),),
        Hinge("revolute", "link_1", (0, 1, 0), (0, 0, 0.05), -0.9, 0.4),
    )
    return write_partnet(ObjectModel("toy", "Box", (board, root), 0, 0), folder)


@dataclasses.dataclass(frozen=True)
class Case:
    folder: Path
    name: str
    recording: Recording
    truth: Truth
    caster: Caster


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("recorded")
    _small_root(place / "own" / "90210077")
    return place


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest, place: Path) -> Case:
    settings, name = SETTINGS, request.param
    if name == "small_root":
        settings, name = dataclasses.replace(SETTINGS, partnet_root=place / "own"), "90210077"
    elif name == "41083":
        settings = dataclasses.replace(SETTINGS, frames=6, partnet_root=REAL, joint="joint_2")
    data = place / request.param
    sequence = record(name, data, settings)
    truth = read_truth(data / "truth" / sequence)
    caster = Caster((truth.articulation.reference, truth.articulation.moving))
    return Case(data, sequence, read_sequence(data / "sequences" / sequence), truth, caster)


# --- the truth against the pictures -----------------------------------------------------------------------------------


def _cast(
    case: Case, camera: Camera, T_reference: np.ndarray, T_moving: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depth, part labels and colours that the truth meshes predict."""
    meshes = case.truth.articulation.reference, case.truth.articulation.moving
    hits = case.caster.look(camera, (T_reference, T_moving))
    shape = camera.height, camera.width
    colours, rays = np.full((len(hits.side), 3), np.nan), camera.rays().reshape(-1, 3)
    for k, mesh in enumerate(meshes):
        here = hits.side == k
        assert mesh.colours is not None
        faces = mesh.faces[hits.face[here]]
        a, b, c = (mesh.vertices[faces[:, j]] @ (T_reference, T_moving)[k][:3, :3].T for j in range(3))
        front = np.einsum("nc,nc->n", np.cross(b - a, c - a), rays[here]) < 0  # real meshes have faces of both sides
        colours[here] = np.where(front[:, None], mesh.colours[faces].mean(1), np.nan)
    return (
        np.where(hits.side >= 0, hits.distance, 0).reshape(shape),
        (hits.side + 1).reshape(shape),
        colours.reshape(*shape, 3),
    )


def test_depth_and_masks_are_those_of_the_posed_truth_meshes(case: Case) -> None:
    truth, camera = case.truth, case.recording.camera
    for i in range(len(truth)):
        depth, labels, _ = _cast(case, camera, truth.Ts_camera_reference[i], truth.Ts_camera_moving[i])
        frame, part_mask = case.recording.frame(i), truth.part_mask(i)
        assert np.mean(labels != part_mask) < 1e-3 and np.mean((labels != part_mask)[part_mask > 0]) < 5e-3
        assert np.array_equal(frame.mask, part_mask > 0) and np.array_equal(frame.depth > 0, frame.mask)
        assert np.array_equal(truth.seen[i], [np.sum(part_mask == 1), np.sum(part_mask == 2)])
        flat = interior_pixels(part_mask) & interior_pixels(labels) & (labels == part_mask) & frame.mask
        error = np.abs(depth - frame.depth)[flat]
        assert flat.sum() > 200 and np.mean(error > 0.002 * truth.diagonal) < 0.005  # 0.5 %: steps within a part
        assert np.median(error) < 1e-4 * truth.diagonal


def test_held_out_views_show_pose_a_and_state_b_from_the_moved_camera(case: Case) -> None:
    truth, recording = case.truth, case.recording
    assert len(recording.queries) == SETTINGS.queries
    for i, query in enumerate(recording.queries):
        assert query.pose_of_frame != query.state_of_frame
        T = query.T_newcam_cam @ truth.Ts_camera_reference[query.pose_of_frame]
        q = truth.states[query.state_of_frame]
        _, labels, colours = _cast(case, recording.camera, T, T @ truth.articulation.joint.transform(q))
        rgb, mask = truth.query_rgb(i), truth.query_mask(i)
        assert np.mean((labels > 0) != mask) < 1e-3
        flat = interior_pixels(labels) & mask & (labels > 0)
        assert np.nanmedian(np.abs(rgb.astype(float) - colours).max(-1)[flat]) < 20  # unlit: the truth's own colours
        assert np.degrees(se3.rotation_angle(query.T_newcam_cam[:3, :3])) < 15.01


def test_lit_by_lamps_that_stand_in_the_world_the_views_render_again_too(tmp_path: Path) -> None:
    lit = {"shader": "default", "width": 96, "height": 54}
    settings = dataclasses.replace(SETTINGS, motion="static_base", frames=2, queries=1, edge=0.5, **lit)
    sequence = record("flip_cap_usb", tmp_path, settings)
    recording, folder = read_sequence(tmp_path / "sequences" / sequence), tmp_path / "truth" / sequence
    again = [psnr for _, psnr in render_again(recording, read_truth(folder), folder, 1)]
    assert min(again) > LEAST_PSNR + 20  # lamps that go with the camera of a view give 35 to 50 dB


def test_verification_by_rays_and_a_second_rendering_finds_nothing(case: Case) -> None:
    handed_on = (case.folder / "truth" / case.name / "object").exists()  # PartNet-Mobility's objects are not
    assert handed_on == (case.truth.source["object_source"] != "partnet")
    assert verify_deep(case.folder, frames=3, views=SETTINGS.queries) == []


def test_the_object_stays_in_the_picture_and_first_shows_both_parts(case: Case) -> None:
    pictures = [case.recording.frame(i).mask for i in range(len(case.truth))]
    pictures += [case.truth.query_mask(i) for i in range(SETTINGS.queries)]
    for mask in pictures:
        assert mask.any() and not (mask[[0, -1]].any() or mask[:, [0, -1]].any())
    assert (case.truth.seen[0] > 0.04 * case.truth.seen[0].sum()).all()


# --- apart from the truth ---------------------------------------------------------------------------------------------


def test_a_sequence_tells_nothing_of_object_seed_motion_or_joint(case: Case) -> None:
    folder = case.folder / "sequences" / case.name
    assert set(json.loads((folder / "sequence.json").read_text())) == {
        "schema",
        "camera",
        "depth_scale",
        "times_s",
        "licence",
        "gravity",
    }
    assert set(json.loads((folder / "queries.json").read_text())["queries"][0]) == {
        "pose_of_frame",
        "state_of_frame",
        "T_newcam_cam",
    }
    assert {p.name for p in folder.iterdir()} == {"sequence.json", "queries.json", "rgb", "depth", "mask"}
    words = [
        b"seed",
        b"tumble",
        b"joint",
        b"link_",
        b"revolute",
        b"prismatic",
        b"axis",
        str(case.truth.source["object"]).encode(),
        str(case.truth.source["category"]).encode(),
    ]
    for path in (*folder.glob("*.json"), *folder.glob("*/00000.png")):
        found = [word for word in words if word in path.read_bytes().lower()]
        assert not found, f"{path.name} says {found}"


def test_the_larger_part_is_the_reference_even_when_the_joint_carries_it(place: Path) -> None:
    data = place / "reference_is_child"
    sequence = record("90210077", data, dataclasses.replace(SETTINGS, partnet_root=place / "own"))
    truth, loaded = read_truth(data / "truth" / sequence), partnet.load(place / "own" / "90210077")
    assert sequence == "90210077-joint_0-s3"
    assert truth.source["reference_links"] == ["link_0"] and truth.source["moving_links"] == ["base", "link_1"]
    joint = truth.articulation.joint
    assert np.allclose(joint.axis, -loaded.joint.axis) and (joint.lower, joint.upper) == (-0.9, 0.4)
    assert truth.states.min() == pytest.approx(-0.9, abs=0.05) and truth.states.max() == pytest.approx(0.4, abs=0.05)
    # at positive states the foot turns against the board as the board turns, at those states, against the foot
    assert np.allclose(joint.transform(0.3), se3.inverse(loaded.joint.transform(0.3)))


# --- seeds ------------------------------------------------------------------------------------------------------------


def test_same_seed_same_bytes(tmp_path: Path) -> None:
    settings = dataclasses.replace(SETTINGS, frames=4, queries=2, edge=0.3)
    hashes = []
    for run in "ab":
        record("flip_lighter", tmp_path / run / "data", settings)
        files = sorted(p for p in (tmp_path / run).rglob("*") if p.is_file())
        hashes.append({str(p.relative_to(tmp_path / run)): file_sha256(p) for p in files})
    assert hashes[0] == hashes[1] and len(hashes[0]) > 20


# --- faults -----------------------------------------------------------------------------------------------------------


def _fails(message: str, name: str, out: Path, **changes: object) -> None:
    with pytest.raises(FreeArtError, match=message) as caught:
        record(name, out, dataclasses.replace(SETTINGS, **changes))  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_bad_requests_get_one_clear_line(tmp_path: Path) -> None:
    _fails("unknown object 'teapot'; objects: swivel_usb, flip_cap_usb, ", "teapot", tmp_path)
    _fails("'45135' is from PartNet-Mobility: give the folder .*; access to the dataset: https://", "45135", tmp_path)
    _fails("object 45135 is not in .*; ask for access", "45135", tmp_path, partnet_root=tmp_path)
    _fails("cannot record 1 frames", "stapler", tmp_path, frames=1)
    _fails("unknown motion 'dance'; motions: tumble, inspect", "stapler", tmp_path, motion="dance")
    _fails("unknown preset 'huge'; presets: handheld, paper", "stapler", tmp_path, preset="huge")
    _fails("unknown sensor 'noisy'; sensors: blur, clean", "stapler", tmp_path, sensor="noisy")
    _fails("unknown shader 'point'; shaders: default, trivial", "stapler", tmp_path, shader="point")
    _fails("cannot draw from seed -1; expected 0 or more", "stapler", tmp_path, seed=-1)
    _fails(
        r"no movable joint 'lid'; movable joints: joint_0 \(revolute .*\), joint_1 \(", "stapler", tmp_path, joint="lid"
    )
    assert list(tmp_path.iterdir()) == []
