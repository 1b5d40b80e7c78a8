"""Methods that see two joint states rather than a video: frames and units proved by a known point."""

import numpy as np
import pytest
from adapters_case import (
    R_LABEL_LINK,
    R_ZUP_LABEL,
    apply,
    few_samples,
    imported,
    lacks,
    moved,
    official_example,
    surface_points,
    truth_of,
    turned,
    world_of,
    write_data,
    write_json,
)
from plyfile_like import write_mesh, write_obj
from test_adapters import assert_perfect

from freeart21.errors import FreeArtError
from freeart21.files.result import read_method, read_result
from leaderboard.adapters.importer import import_results
from leaderboard.adapters.layout import IN_OBJECT, Options

ANCHOR = 4
"""The frame of the video that shows the first state."""
ZUP = world_of(R_ZUP_LABEL @ R_LABEL_LINK)
LACKS = ("states", "poses", "masks", "renders")
WRITTEN = 0.01
"""% of the diagonal that meshes written with eight digits leave."""


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_data(tmp_path_factory.mktemp("data"))


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    few_samples(monkeypatch)


@pytest.fixture
def src(tmp_path):
    return tmp_path / "theirs"


@pytest.fixture
def examples(tmp_path):
    for name in ("a", "b", "c"):
        official_example(tmp_path / "official" / "examples" / name, truth_of(name))
    return tmp_path / "official"


def parts_at(truth, state, world):
    """Reference and moving part of the truth at a joint state, in `world` (from the object's frame)."""
    joint = truth.articulation.joint
    reference, moving = truth.articulation.reference, truth.articulation.moving
    return (
        (apply(world, reference.vertices), reference.faces),
        (apply(world @ moved(joint, state), moving.vertices), moving.faces),
    )


def assert_states(row, name="a", chamfer=WRITTEN):
    """All that such a method can be right about is right, and nothing else has a number."""
    assert_perfect(row, position=name == "a", state=False, poses=False, masks=False, chamfer=chamfer)
    for id in ("state", "state_all", "miou", "pose_rotation", "pose_moving_translation", "psnr", "ssim"):
        assert row.values[id] is None, id


def test_frames_that_hang_on_the_object():
    assert IN_OBJECT["label"][:3, :3] == pytest.approx(R_LABEL_LINK.T)
    assert IN_OBJECT["zup"][:3, :3] == pytest.approx((R_ZUP_LABEL @ R_LABEL_LINK).T)


# PARIS


def paris(folder, name="a", *, world=ZUP, end=1.0, start_mesh=True, old=True):
    """The save folder of an experiment from the state of frame ANCHOR to `end` rad (or m/5 further)."""
    truth = truth_of(name)
    joint, first = truth.articulation.joint, truth.states[ANCHOR]
    turns = joint.type == "revolute"
    amount = (end if turns else end / 5) - first
    axis, pivot = world[:3, :3] @ joint.axis, apply(world, joint.pivot)
    motion = {"type": "rotate" if turns else "translate", "axis_o": pivot.tolist(), "axis_d": axis.tolist()}
    if turns:
        motion |= {"rot_angle": [np.degrees(amount)], "R": np.eye(3).tolist()}
    else:
        motion |= {"dist": amount}
    if old:
        write_json(folder / "save" / "it5000_val_motion.json", motion | {"axis_d": [1, 0, 0]})
    write_json(folder / "save" / "it20000_test_motion.json", motion)
    static, moving = parts_at(truth, first, world)
    half = parts_at(truth, first + amount / 2, world)[1]
    write_mesh(folder / "save" / "it20000_static_256_thre5.0.ply", *static)
    write_mesh(folder / "save" / "it20000_dynamic_256_thre5.0.ply", *half)
    if start_mesh:
        write_mesh(folder / "save" / "it20000_dyn_t0_256_thre5.0.ply", *moving)
    return amount


@pytest.mark.parametrize("name", ["a", "b"])
@pytest.mark.parametrize("start_mesh", [True, False])
def test_paris(data, tmp_path, src, examples, name, start_mesh):
    amount = paris(src / name, name, start_mesh=start_mesh)
    row = imported(data, src, tmp_path / "r", "paris", name=name, object_poses=examples, anchor=ANCHOR)
    assert_states(row, name)
    assert lacks(tmp_path / "r") == LACKS
    answer = read_result(tmp_path / "r" / name)
    assert (
        answer.anchor == ANCHOR
        and answer.articulation.joint.upper - answer.articulation.joint.lower == pytest.approx(abs(amount))
    )


def test_paris_in_the_cameras_frame(data, tmp_path, src):
    truth = truth_of()
    paris(src / "a", world=truth.Ts_camera_reference[ANCHOR])
    row = imported(data, src, tmp_path / "r", "paris", frame="camera", anchor=ANCHOR)
    assert_states(row)


def test_paris_in_another_frame_scores_badly(data, tmp_path, src, examples):
    paris(src / "a")
    for frame in ("label", "link"):
        row = imported(data, src, tmp_path / "r", "paris", object_poses=examples, anchor=ANCHOR, frame=frame)
        assert max(row.values["axis"], row.values["position"], row.values["chamfer_w"]) > 10, frame


def test_paris_at_another_frame_of_the_video_scores_badly(data, tmp_path, src, examples):
    paris(src / "a")
    row = imported(data, src, tmp_path / "r", "paris", object_poses=examples, anchor=9)
    assert (
        row.values["axis"] < 0.01 and row.values["chamfer_m"] > 1
    )  # the joint holds in every frame, the state does not


def test_paris_without_the_objects_pose_is_refused(data, tmp_path, src):
    paris(src / "a")
    with pytest.raises(FreeArtError, match=r"stands in the object's frame \(zup\).*--object-poses.*--frame camera"):
        import_results("paris", src, data, tmp_path / "r")
    assert not (tmp_path / "r").exists()


def test_paris_takes_the_longest_trained(data, tmp_path, src, examples):
    paris(src / "a", old=True)
    row = imported(data, src, tmp_path / "r", "paris", object_poses=examples, anchor=ANCHOR)
    assert row.values["axis"] < 0.01


def test_lengths_are_scaled(data, tmp_path, src, examples):
    truth = truth_of("b")
    paris(src / "b", "b")
    row = imported(data, src, tmp_path / "r", "paris", name="b", object_poses=examples, anchor=ANCHOR, scale=2.0)
    answer = read_result(tmp_path / "r" / "b")
    span = answer.articulation.joint.upper - answer.articulation.joint.lower
    assert span == pytest.approx(2 * (0.2 - truth.states[ANCHOR])) and row.values["chamfer_w"] > 5


# DigitalTwinArt


def digitaltwinart(folder, name="a", *, known=True, second=1.0, step="step_0004000"):
    truth = truth_of(name)
    joint, first = truth.articulation.joint, truth.states[ANCHOR]
    turns = joint.type == "revolute"
    axis, pivot = ZUP[:3, :3] @ joint.axis, apply(ZUP, joint.pivot)
    amount = (second if turns else second / 5) - first
    T = turned(axis, pivot, amount) if turns else np.eye(4)
    if not turns:
        T[:3, 3] = axis * amount
    on_axis = pivot - axis * (axis @ pivot)
    hinge = {"axis_position": on_axis.tolist(), "axis_direction": (axis * np.sign(amount)).tolist()}
    hinge |= {"theta": float(np.degrees(abs(amount)))}
    shift = T[:3, 3]
    slide = {"axis_direction": (shift / np.linalg.norm(shift)).tolist(), "axis_position": [0.0, 0.0, 0.0]}
    slide |= {"theta": float(np.linalg.norm(shift))}
    both = {"rotation": T[:3, :3].tolist(), "translation": shift.tolist()}
    home = folder / "results" / step
    if known:
        write_json(home / "init_motion.json", [(hinge if turns else slide) | both])
    else:
        write_json(home / "init_revolute_motion.json", [hinge | both])
        write_json(home / "init_prismatic_motion.json", [slide | both])
    for k, (vertices, faces) in enumerate(parts_at(truth, first, ZUP)):
        write_obj(home / f"init_part_{k}.obj", vertices, faces)
    return home


@pytest.mark.parametrize("name", ["a", "b"])
@pytest.mark.parametrize("known", [True, False])
def test_digitaltwinart(data, tmp_path, src, examples, name, known):
    digitaltwinart(src / name, name, known=known)
    row = imported(data, src, tmp_path / "r", "digitaltwinart", name=name, object_poses=examples, anchor=ANCHOR)
    assert_states(row, name)
    assert lacks(tmp_path / "r") == LACKS
    notes = " ".join(read_method(tmp_path / "r").settings["notes"][name])
    assert ("joint type is an input" in notes) == known and ("the import chose" in notes) != known
    joint = read_result(tmp_path / "r" / name).articulation.joint
    assert joint.upper - joint.lower == pytest.approx(
        abs((1.0 if name == "a" else 0.2) - truth_of(name).states[ANCHOR])
    )


def test_digitaltwinart_takes_the_last_step(data, tmp_path, src, examples):
    digitaltwinart(src / "a", step="step_0004000")
    write_json(src / "a" / "results" / "step_0000500" / "init_motion.json", [])
    row = imported(data, src, tmp_path / "r", "digitaltwinart", object_poses=examples, anchor=ANCHOR)
    assert row.values["axis"] < 0.01


# ArtGS


def artgs(folder, name="a", *, extra=False, iteration=20000):
    truth = truth_of(name)
    joint, first = truth.articulation.joint, truth.states[ANCHOR]
    home = folder / "train" / f"ours_{iteration}"
    axis, pivot = ZUP[:3, :3] @ joint.axis, apply(ZUP, joint.pivot)
    kind = "hinge" if joint.type == "revolute" else "slider"
    entries = [
        {"id": 0, "parent": -1, "name": "root", "joint": "heavy", "jointData": {}, "visuals": ["meshes/start_0.ply"]}
    ]
    entry = {"id": 1, "parent": 0, "name": "joint_1", "joint": kind, "visuals": ["meshes/start_1.ply"]}
    entry["jointData"] = {"axis": {"origin": pivot.tolist(), "direction": axis.tolist()}, "limit": {}}
    entries.append(entry)
    for k, (vertices, faces) in enumerate(parts_at(truth, first, ZUP)):
        if extra and k == 0:  # half of the body hangs on another joint
            write_mesh(home / "meshes" / "start_2.ply", vertices, faces[::2])
            faces = faces[1::2]
        write_mesh(home / "meshes" / f"start_{k}.ply", vertices, faces)
    if extra:
        entries.append(entry | {"id": 2, "name": "joint_2", "visuals": ["meshes/start_2.ply"]})
    write_json(home / "joint_info.json", entries)
    return home


@pytest.mark.parametrize("name", ["a", "b"])
def test_artgs(data, tmp_path, src, examples, name):
    artgs(src / name, name)
    row = imported(data, src, tmp_path / "r", "artgs", name=name, object_poses=examples, anchor=ANCHOR)
    assert_states(row, name)
    assert lacks(tmp_path / "r") == LACKS
    assert np.isinf(read_result(tmp_path / "r" / name).articulation.joint.upper)


def test_artgs_with_two_joints_needs_to_be_told_which(data, tmp_path, src, examples):
    artgs(src / "a", extra=True)
    with pytest.raises(FreeArtError, match="joints joint_1, joint_2; expected one, or --joint"):
        imported(data, src, tmp_path / "r", "artgs", object_poses=examples, anchor=ANCHOR)
    for joint in ("joint_1", "0"):
        row = imported(data, src, tmp_path / "r", "artgs", object_poses=examples, anchor=ANCHOR, joint=joint)
        assert_states(row)  # the rest of the parts are one with the body


def test_artgs_meshes_stay_in_the_folder(data, tmp_path, src, examples):
    home = artgs(src / "a")
    text = (home / "joint_info.json").read_text().replace("meshes/start_1.ply", "../../../../secret.ply")
    (home / "joint_info.json").write_text(text)
    with pytest.raises(FreeArtError, match="leads out of the folder"):
        imported(data, src, tmp_path / "r", "artgs", object_poses=examples)


# Articulate-Anything


def articulate_anything(folder, name="a", *, lower=0.0, upper=1.2):
    """The URDF of the truth with its base turned as PartNet-Mobility's: meshes in the label frame."""
    truth = truth_of(name)
    joint, label = truth.articulation.joint, world_of(R_LABEL_LINK)
    axis, pivot = label[:3, :3] @ joint.axis, apply(label, joint.pivot)
    state = truth.states[ANCHOR]  # position zero is what the anchor frame shows
    body, lid = parts_at(truth, state, label)
    write_obj(folder / "textured_objs" / "body.obj", *body)
    write_obj(folder / "textured_objs" / "lid.obj", *lid)
    xyz = "{:.12g} {:.12g} {:.12g}".format
    visual = '<visual><origin xyz="{}"/><geometry><mesh filename="textured_objs/{}.obj"/></geometry></visual>'.format
    (folder / "mobility.urdf").write_text(
        '<?xml version="1.0"?><robot name="made"><link name="base"/>'
        f'<link name="body">{visual("0 0 0", "body")}</link><link name="lid">{visual(xyz(*-pivot), "lid")}</link>'
        '<joint name="base_to_body" type="fixed"><parent link="base"/><child link="body"/>'
        '<origin xyz="0 0 0" rpy="1.570796326794897 0 -1.570796326794897"/></joint>'
        f'<joint name="body_to_lid" type="{joint.type}"><parent link="body"/><child link="lid"/>'
        f'<origin xyz="{xyz(*pivot)}" rpy="0 0 0"/><axis xyz="{xyz(*axis)}"/>'
        f'<limit lower="{lower}" upper="{upper}"/></joint></robot>'
    )
    return folder


@pytest.mark.parametrize("name", ["a", "b"])
def test_articulate_anything(data, tmp_path, src, examples, name):
    articulate_anything(src / name / "joint_actor" / "iter_0" / "seed_1", name)
    row = imported(data, src, tmp_path / "r", "articulate-anything", name=name, object_poses=examples, anchor=ANCHOR)
    assert_states(row, name)
    assert lacks(tmp_path / "r") == LACKS
    joint = read_result(tmp_path / "r" / name).articulation.joint
    assert (joint.lower, joint.upper) == (0.0, 1.2)


def test_articulate_anything_in_the_label_frame_scores_badly(data, tmp_path, src, examples):
    articulate_anything(src / "a")
    row = imported(
        data, src, tmp_path / "r", "articulate-anything", object_poses=examples, anchor=ANCHOR, frame="label"
    )
    assert row.values["chamfer_w"] > 5


# ScrewSplat


def screwsplat(folder, name="a", *, order="wv", shown=2, unit=1.0):
    """Arrays by the conventions of ScrewSplat in the camera's frame of the anchor, lengths in `unit`s, metres.

    The second screw is the joint."""
    truth = truth_of(name)
    joint, first, world = truth.articulation.joint, truth.states[ANCHOR], truth.Ts_camera_reference[ANCHOR]
    axis, pivot = world[:3, :3] @ joint.axis, apply(world, joint.pivot)
    turns = joint.type == "revolute"
    w, v = (axis, -np.cross(axis, pivot) / unit) if turns else (np.zeros(3), axis)
    folder.mkdir(parents=True)
    np.save(folder / "screws.npy", np.array([[0, 0, 1, 0, 0, 0], [*w, *v] if order == "wv" else [*v, *w]]))
    np.save(folder / "screw_confs.npy", np.array([0.05, 0.97]))
    thetas = truth.states - first if shown is None else np.linspace(0, 0.5, shown)
    thetas = thetas / (1.0 if turns else unit)
    np.save(folder / "theta.npy", np.stack([np.zeros(len(thetas)), thetas], 1))
    for label, mesh, T in (
        ("static", truth.articulation.reference, world),
        ("movable_2", truth.articulation.moving, world @ moved(joint, first)),
    ):
        np.save(folder / f"point_cloud_{label}.npy", apply(T, surface_points(mesh, 3000)) / unit)
    return folder


@pytest.mark.parametrize("name", ["a", "b"])
def test_screwsplat(data, tmp_path, src, name):
    screwsplat(src / name, name, unit=0.4)
    row = imported(data, src, tmp_path / "r", "screwsplat", name=name, anchor=ANCHOR, scale=0.4)
    assert_states(row, name, chamfer=1.0)
    assert lacks(tmp_path / "r") == LACKS


def test_screwsplat_has_states_where_it_saw_every_frame(data, tmp_path, src):
    screwsplat(src / "a", shown=None)
    row = imported(data, src, tmp_path / "r", "screwsplat", anchor=ANCHOR)
    assert row.values["state"] < 0.01 and row.values["axis"] < 0.01 and row.values["chamfer_w"] < 1
    assert lacks(tmp_path / "r") == LACKS[1:]


def test_screwsplat_with_v_before_w_scores_badly(data, tmp_path, src):
    screwsplat(src / "b", "b", order="vw")
    row = imported(data, src, tmp_path / "r", "screwsplat", name="b", anchor=ANCHOR)
    assert row.values["joint_type"] == 0


def test_screwsplats_own_pickles_are_not_read(data, tmp_path, src):
    screwsplat(src / "a")
    np.save(src / "a" / "screws.npy", {"joint_0": {"screw": [0.0] * 6}}, allow_pickle=True)
    with pytest.raises(FreeArtError, match="without pickled objects"):
        import_results("screwsplat", src, data, tmp_path / "r", Options(anchor=ANCHOR))
