"""Methods that follow parts: frames and units proved by a known point, and the joint that is fitted for them."""

import json

import numpy as np
import pytest
from adapters_case import (
    GL,
    apply,
    few_samples,
    imported,
    lacks,
    rigid,
    surface_points,
    truth_of,
    write_data,
    write_json,
    wxyz,
)
from plyfile_like import write_cloud, write_obj
from test_adapters import assert_perfect

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files.result import read_method, read_result
from freeart21.joint import Joint
from leaderboard.adapters.fitting import fit_joint
from leaderboard.adapters.importer import import_results
from leaderboard.adapters.layout import Options
from leaderboard.adapters.readers import number_frames


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_data(tmp_path_factory.mktemp("data"))


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    few_samples(monkeypatch)


@pytest.fixture
def src(tmp_path):
    return tmp_path / "theirs"


# RSRD

SCALE = 2.5
"""nerfstudio's units in a metre."""


def rsrd(folder, name="a", *, order="wxyz", scale_file=True, camera=GL):
    """keyframes.txt of the truth, scanned at its joint state zero in a world of its own, in units of 1/SCALE m."""
    truth, world = truth_of(name), rigid(3)
    parts = (truth.articulation.reference, truth.articulation.moving)
    clouds = [surface_points(part, count, k) for k, (part, count) in enumerate(zip(parts, (4000, 3000), strict=True))]
    clouds = [(SCALE * apply(world, cloud)).astype(np.float32).astype(float) for cloud in clouds]
    mean_all = np.concatenate(clouds).mean(0)
    means = [cloud.mean(0) for cloud in clouds]

    def carried(T_camera_part):
        """Scanned points x in nerfstudio's units to the camera's: SCALE * camera T world^-1 (x / SCALE)."""
        T = camera @ T_camera_part @ np.linalg.inv(world)
        T[:3, 3] *= SCALE
        return T

    def shift(t):
        T = np.eye(4)
        T[:3, 3] = t
        return T

    def row(T):
        q = wxyz(T[:3, :3])
        return [*(q if order == "wxyz" else np.roll(q, -1)), *T[:3, 3]]

    Ts = (truth.Ts_camera_reference, truth.Ts_camera_moving)
    to_object = shift(mean_all)
    start = np.linalg.inv(to_object) @ carried(Ts[0][0]) @ to_object
    deltas = []
    for i in range(len(truth)):
        both = []
        for k in (0, 1):
            to_part = shift(means[k] - mean_all)
            moved = carried(Ts[k][i])
            both.append(row(np.linalg.inv(to_object @ start @ to_part) @ moved @ to_object @ to_part))
        deltas.append(both)
    write_json(folder / "keyframes.txt", {"part_deltas": deltas, "T_objreg_objinit": [row(start)], "hands": {}})
    for k, cloud in enumerate(clouds):
        write_cloud(folder / f"part_{k}.ply", cloud)
    if scale_file:
        transform = np.eye(4)[:3].tolist()
        write_json(folder / "dataparser_transforms.json", {"transform": transform, "scale": SCALE})
    return folder


@pytest.mark.parametrize("name", ["a", "b"])
def test_rsrd(data, tmp_path, src, name):
    rsrd(src / name, name)
    row = imported(data, src, tmp_path / "r", "rsrd", name=name)
    assert_perfect(row, position=name == "a", masks=False)
    assert lacks(tmp_path / "r") == ("masks", "renders")
    assert "fitted" in read_method(tmp_path / "r").settings["notes"][name][0]


@pytest.mark.parametrize(
    "wrong, id, least",
    [
        ({"order": "xyzw"}, "pose_rotation", 5),
        ({"scale_file": False}, "pose_translation", 10),
        ({"camera": np.eye(4)}, "pose_rotation", 5),
    ],
)
def test_rsrd_written_otherwise_scores_badly(data, tmp_path, src, wrong, id, least):
    rsrd(src / "a", **wrong)
    assert imported(data, src, tmp_path / "r", "rsrd").values[id] > least


def test_rsrd_takes_the_scale_that_it_is_told(data, tmp_path, src):
    rsrd(src / "a", scale_file=False)
    row = imported(data, src, tmp_path / "r", "rsrd", scale=1 / SCALE)
    assert_perfect(row, masks=False)


def test_rsrd_says_that_the_parts_gaussians_are_needed(data, tmp_path, src):
    rsrd(src / "a")
    (src / "a" / "part_1.ply").unlink()
    with pytest.raises(FreeArtError, match=r"part_1.ply is missing: .* export the Gaussians"):
        import_results("rsrd", src, data, tmp_path / "r")
    assert not (tmp_path / "r").exists()


# BundleSDF and FoundationPose


def tracked(run, Ts, mesh, seed, *, names=None, obj="textured_mesh.obj", savetxt=False):
    """One run on one part: its own frame, the poses of that frame in the camera, and the part in it."""
    own = rigid(seed)
    write_obj(run / obj, apply(own, mesh.vertices), mesh.faces)
    (run / "ob_in_cam").mkdir(parents=True)
    for i, T in enumerate(Ts @ np.linalg.inv(own)):
        path = run / "ob_in_cam" / f"{names[i] if names else f'{i:04d}'}.txt"
        if savetxt:
            np.savetxt(path, T)
        else:
            path.write_text("\n".join(" ".join(f"{x: .10g}" for x in row) for row in T) + "\n")
    return run


def runs_of(folder, name="a", of=lambda T: T, **options):
    truth = truth_of(name)
    parts = truth.articulation
    tracked(folder / "reference", of(truth.Ts_camera_reference), parts.reference, 4, **options)
    tracked(folder / "moving", of(truth.Ts_camera_moving), parts.moving, 5, **options)
    return folder


@pytest.mark.parametrize("name", ["a", "b"])
def test_bundlesdf(data, tmp_path, src, name):
    runs_of(src / name, name)
    row = imported(data, src, tmp_path / "r", "bundlesdf", name=name)
    assert_perfect(row, position=name == "a", masks=False, chamfer=0.01)
    assert lacks(tmp_path / "r") == ("masks", "renders")


def test_bundlesdf_with_poses_of_an_opengl_camera_scores_badly(data, tmp_path, src):
    runs_of(src / "a", of=lambda Ts: GL @ Ts)
    assert imported(data, src, tmp_path / "r", "bundlesdf").values["pose_rotation"] > 5


def test_bundlesdf_with_the_camera_in_the_object_scores_badly(data, tmp_path, src):
    runs_of(src / "a", of=np.linalg.inv)
    assert imported(data, src, tmp_path / "r", "bundlesdf").values["pose_rotation"] > 5


def test_bundlesdfs_normalised_mesh_is_not_read(data, tmp_path, src):
    runs_of(src / "a", obj="mesh_cleaned.obj")
    row = imported(data, src, tmp_path / "r", "bundlesdf")
    assert lacks(tmp_path / "r") == ("masks", "meshes", "renders")
    assert row.values["chamfer_w"] is None and row.values["axis"] < 0.01 and row.values["state"] < 0.01


def test_foundationpose_with_time_stamps_for_names(data, tmp_path, src):
    stamps = [str(1581120424100262102 + 33333333 * i) for i in range(16)]
    runs_of(src / "a", names=stamps, obj="mesh.obj", savetxt=True)
    row = imported(data, src, tmp_path / "r", "foundationpose")
    assert_perfect(row, masks=False, chamfer=0.01)
    assert any("in their order" in line for line in read_method(tmp_path / "r").settings["notes"]["a"])


def test_one_run_is_the_reference_parts_poses_and_no_joint(data, tmp_path, src):
    truth = truth_of()
    tracked(src / "a", truth.Ts_camera_reference, truth.articulation.reference, 4)
    row = imported(data, src, tmp_path / "r", "bundlesdf")
    assert row.values["pose_rotation"] < 0.01 and row.values["pose_translation"] < 0.01
    assert lacks(tmp_path / "r") == ("joint", "states", "masks", "meshes", "renders")
    assert row.values["axis"] is None and row.values["joint_type"] is None
    assert "no joint" in read_method(tmp_path / "r").settings["notes"]["a"][0]


@pytest.mark.parametrize(
    "stems, expected",
    [
        (["0000", "0001", "0002"], [0, 1, 2]),
        (["00000", "00002"], [0, 2]),
        (["1", "2", "3"], [0, 1, 2]),
        (["10", "9", "200"], [1, 0, 2]),
        (["b", "a", "c"], [1, 0, 2]),
    ],
)
def test_names_of_frames(stems, expected):
    assert number_frames(stems, 3, "here")[0].tolist() == expected


@pytest.mark.parametrize("stems", [["0", "7"], ["00", "0"], [], ["x"]])
def test_names_that_fit_no_frames(stems):
    with pytest.raises(FreeArtError, match="here"):
        number_frames(stems, 3, "here")


# The joint that is fitted


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
    assert fit.joint.type == kind and fit.residual < 1e-6
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


def test_the_residual_of_the_other_type_is_larger():
    _, _, motion, centre = measured("revolute", np.random.default_rng(0), span=1.0)
    fit = fit_joint("j", motion, centre, 0.2)
    assert fit.other_residual > 100 * max(fit.residual, 1e-6)


def test_parts_that_do_not_move_have_no_joint():
    still = np.repeat(rigid(0)[None], 10, 0)
    with pytest.raises(FreeArtError, match="does not move"):
        fit_joint("j", still, np.zeros(3), 0.2)


def test_runs_without_a_common_frame_and_too_many_runs(data, tmp_path, src):
    truth = truth_of()
    tracked(src / "a" / "x", truth.Ts_camera_reference[:4], truth.articulation.reference, 4)
    tracked(src / "a" / "y", truth.Ts_camera_moving[:4], truth.articulation.moving, 4)
    for path in (src / "a" / "y" / "ob_in_cam").iterdir():
        path.rename(path.with_stem(f"{int(path.stem) + 8:04d}"))
    with pytest.raises(FreeArtError, match="no frame in common"):
        import_results("bundlesdf", src, data, tmp_path / "r")
    tracked(src / "a" / "z", truth.Ts_camera_moving, truth.articulation.moving, 4)
    with pytest.raises(FreeArtError, match="3 runs"):
        import_results("bundlesdf", src, data, tmp_path / "r")


def test_a_rotation_that_is_none_is_refused(data, tmp_path, src):
    runs_of(src / "a", of=lambda Ts: 2 * Ts)
    with pytest.raises(FreeArtError, match="not a rigid pose"):
        import_results("bundlesdf", src, data, tmp_path / "r")


def test_a_third_part_goes_with_the_one_that_it_does_not_move_against(data, tmp_path, src):
    rsrd(src / "a")
    path = src / "a" / "keyframes.txt"
    tracks = json.loads(path.read_text())
    for row in tracks["part_deltas"]:
        row.append(row[1])
    path.write_text(json.dumps(tracks))
    (src / "a" / "part_2.ply").write_bytes((src / "a" / "part_1.ply").read_bytes())
    import_results("rsrd", src, data, tmp_path / "r", Options())
    parts = read_result(tmp_path / "r" / "a").articulation
    assert len(parts.moving.faces) == 6000 and len(parts.reference.faces) == 4000
