"""Whether to trust an answer: each sign on answers that have its fault alone, and what the solver measures for them."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh
from reconstruct_clip import OBJECTS, _render, box, make_clip
from test_diagnostics import long_result, sample_diagnostics

from freeart21 import se3
from freeart21.articulation import PARTS, Articulation
from freeart21.camera import Camera
from freeart21.files.diagnostics import diagnostics_from_json, diagnostics_to_json
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.processes import DOUBTFUL
from freeart21.reconstruction import Alternative, Reconstruction, Trust
from freeart21.recording import Frame, Recording
from freeart21.trust import _pose_uncertainty, _surface_off_video, judge, measure_motion, object_size
from reconstruct.commands import _print_result
from reconstruct.diagnostics import (
    other_motion_cost,
    rival_distance,
    unexplained,
)
from reconstruct.evidence import Evidence
from reconstruct.joint_type import RIVAL_COST, choose_joint_type, find_rival
from reconstruct.poses import JointedPoses
from reconstruct.propagation import PartEstimate, body_points
from reconstruct.scene import estimate_correlated_noise, prepare_scene
from reconstruct.settings import EvidenceSettings, LabelSettings, ReconstructSettings, SceneSettings
from reconstruct.surface_check import _seen_share, check_surfaces

N = 60


def sound_diagnostics(**changes):
    """Of a perfect answer, with all that a solver may measure."""
    known = {
        "unexplained": np.zeros(N),
        "other_motion_cost": np.full((N, 2), 2.0),
        "rival_distance": np.where(np.arange(N) % 3 == 0, 0.0, np.nan),
        "type_costs": np.array([0.3, 1.2]),
        "uncovered": np.where(np.arange(N)[:, None] % 3 == 0, 0.0, np.nan) * np.ones(2),
        "spilled": np.zeros((N, 2)),
        "off_surface": np.full((N, 2), 0.005),
        "colour_residual": np.ones((N, 2)),
        "extent_ratio": np.array([1.1, 0.8]),
        "seen_share": np.array([0.95, 0.9]),
    }
    return replace(sample_diagnostics(N), **{**known, **changes})


def reasons(result=None, **changes):
    trust = judge(long_result(N) if result is None else result, sound_diagnostics(**changes))
    assert (trust.verdict == "doubtful") == bool(trust.reasons)
    return list(trust.reasons)


# ---------------------------------------------------------------- the signs


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_perfect_answer_is_sound_with_and_without_diagnostics(kind):
    result = long_result(N, joint_type=kind)
    assert judge(result) == judge(result, sound_diagnostics()) == Trust("sound")


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"unexplained": np.where(np.arange(N) < 10, 0.03, 0.0)}, "3.0 % of the object's pixels follow neither"),
        ({"other_motion_cost": np.tile([0.3, 2.0], (N, 1))}, "reference part's pixels follow the other part's motion"),
        ({"rival_distance": np.where(np.arange(N) % 3 == 0, 0.1, np.nan)}, "a state 6° away explains 100 %"),
        (
            {"uncovered": np.where(np.arange(N) < N / 5, 0.08, 0.0)[:, None] * [1.0, 0.0]},
            "8 % of the reference part's pixels lie on neither surface in a tenth of the frames, most in frame 0",
        ),
        ({"spilled": np.tile([0.06, 0.0], (N, 1))}, "6 % of the reference part's surface lies off the mask"),
        ({"off_surface": np.tile([0.0, 0.03], (N, 1))}, "3 % of the moving part's pixels lie off its surface"),
        ({"colour_residual": np.tile([20.0, 0.0], (N, 1))}, "reference part's colours are not those of the video: 20"),
        ({"off_surface": np.tile([0.0, 1.0], (N, 1))}, "100 % of the moving part's pixels lie off its surface"),
        ({"extent_ratio": np.array([1.0, 860.0])}, "the moving part's surface extends over 860 times what its pixels"),
        ({"extent_ratio": np.array([0.5, 1.0])}, "the reference part's surface extends over 0.5 times what its pixels"),
        ({"seen_share": np.array([1.0, 0.4])}, "only 40 % of the moving part's surface was seen where it is"),
    ],
)
def test_each_measured_sign_alone(changes, words):
    (found,) = reasons(**changes)
    assert words in found


@pytest.mark.parametrize("difference, words", [(0.02, "only 0.02 more"), (-0.01, "no more")])
def test_a_rival_of_the_other_type_is_a_sign(difference, words):
    result = long_result(N)
    slide = replace(result.articulation.joint, type="prismatic")
    (found,) = reasons(replace(result, alternatives=(Alternative(slide, np.zeros(N), difference),)))
    assert found == f"revolute or prismatic is undecided: under a prismatic joint a pixel costs {words}"


def test_what_is_not_known_is_no_sign():
    nothing = np.full(N, np.nan)
    assert not reasons(unexplained=nothing, other_motion_cost=np.full((N, 2), np.nan), rival_distance=nothing)
    assert not reasons(unexplained=None, other_motion_cost=None, rival_distance=None, type_costs=None)
    unmeasured, pair = np.full((N, 2), np.nan), np.full(2, np.nan)
    assert not reasons(
        uncovered=unmeasured, spilled=unmeasured, off_surface=unmeasured, extent_ratio=pair, seen_share=pair
    )
    assert not reasons(uncovered=None, spilled=None, off_surface=None, extent_ratio=None, seen_share=None)


def with_states(states, kind="revolute"):
    result = long_result(N, joint_type=kind)
    moving = result.Ts_camera_reference @ result.articulation.joint.transform(states)
    return replace(result, states=states, Ts_camera_moving=moving)


@pytest.mark.parametrize("degrees, doubted", [(45, True), (122, True), (5, False)])
def test_a_jump_of_the_state(degrees, doubted):
    states = long_result(N).states.copy()
    states[40:] += np.radians(degrees)
    found = reasons(with_states(states))
    assert bool(found) == doubted and all("jumps by up to" in text and "(40)" in text for text in found)


@pytest.mark.parametrize("first, last, doubted", [(0, 13, False), (0, 16, True), (44, 59, True), (20, 45, False)])
def test_states_beyond_what_was_seen_are_guesses_and_those_between_are_not(first, last, doubted):
    seen = np.ones((N, 2), bool)
    seen[first : last + 1, 1] = False
    found = reasons(replace(long_result(N), seen=seen))
    assert bool(found) == doubted and all(f"{last + 1 - first} of 60 states are extrapolated" in t for t in found)


def test_poses_off_the_joint_count_by_what_they_shift():
    result = long_result(N)
    moving = result.articulation.moving
    used = moving.vertices[np.unique(moving.faces)]
    turn = se3.exp_so3(np.radians(30) * np.array([0.0, 0.0, 1.0]))
    gap = se3.pose(turn, used.mean(0) - turn @ used.mean(0))
    turned = replace(result, Ts_camera_moving=result.Ts_camera_moving @ gap)
    off = np.sqrt(((se3.transform(gap, used) - used) ** 2).sum(-1).mean())
    assert measure_motion(turned).gap_surface == pytest.approx(off)
    (found,) = reasons(turned)
    assert "measured poses lie off the joint" in found
    thin = replace(moving, vertices=used.mean(0) + 0.01 * (moving.vertices - used.mean(0)))
    parts = replace(result.articulation, moving=thin)
    assert not reasons(replace(turned, articulation=parts)), "30 degrees of next to nothing"


def test_a_part_whose_own_pose_is_undetermined_may_lie_off_the_joint():
    """Turned by 30 degrees about an axis about which the video does not determine it, by 20 degrees or by 2."""
    result = long_result(N)
    used = result.articulation.moving.vertices[np.unique(result.articulation.moving.faces)]
    Ts = result.Ts_camera_moving
    centre, axis = se3.transform(Ts, used.mean(0)[None, None])[:, 0], np.array([0.0, 0.6, 0.8])
    own = np.concatenate([np.cross(centre, axis), np.tile(axis, (N, 1))], 1)  # turns about the axis through the centre
    turned = replace(result, Ts_camera_moving=se3.exp_se3(np.radians(30) * own) @ Ts)
    points = se3.transform(Ts[:1], used[None])[0] - centre[0]
    for degrees, doubted in ((2.0, True), (20.0, False)):
        covariances = np.zeros((N, 2, 6, 6))
        covariances[:, 1] = np.radians(degrees) ** 2 * own[:, :, None] * own[:, None]
        found = replace(turned, covariances=covariances)
        lever = np.sqrt((np.cross(axis, points) ** 2).sum(1).mean())
        assert _pose_uncertainty(replace(found, Ts_camera_moving=Ts))[0] == pytest.approx(np.radians(degrees) * lever)
        assert ["lie off the joint" in text for text in reasons(found)] == [True] * doubted


def test_motion_too_fast_for_the_frame_rate():
    result = long_result(N)
    fast = se3.pose(se3.exp_so3(np.arange(N)[:, None] * [0, np.radians(35), 0]), result.Ts_camera_reference[:, :3, 3])
    moving = fast @ result.articulation.joint.transform(result.states)
    (found,) = reasons(replace(result, Ts_camera_reference=fast, Ts_camera_moving=moving))
    assert found.startswith("a part turns by 35° from frame to frame")


@pytest.mark.parametrize(
    "stds, words", [((0.1, 1e-4), ["axis is known to 5.7°"]), ((1e-3, 0.02), ["axis line is known to 20 mm"])]
)
def test_a_joint_that_is_not_well_known(stds, words):
    found = reasons(replace(long_result(N), axis_std=stds[0], pivot_std=stds[1]))
    assert len(found) == len(words) and all(word in text for word, text in zip(words, found, strict=True))


def test_the_command_says_it_last_and_in_its_exit_code(tmp_path, capsys):
    result = replace(long_result(N), axis_std=0.002, pivot_std=0.0003, trust=Trust("sound"))
    assert _print_result(result, tmp_path) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "sound" and "(axis to 0.11 deg, pivot to 0.3 mm)" in lines[0]
    assert _print_result(replace(result, trust=Trust("doubtful", ("a", "b"))), tmp_path) == DOUBTFUL == 3
    assert capsys.readouterr().out.splitlines()[-1] == "doubtful: a; b"


def test_measured_signs_round_trip(tmp_path):
    found = diagnostics_from_json(diagnostics_to_json(sound_diagnostics()), tmp_path)
    for name in ("unexplained", "other_motion_cost", "rival_distance", "type_costs", "uncovered", "seen_share"):
        np.testing.assert_array_equal(getattr(found, name), getattr(sound_diagnostics(), name))
    turned = found.exchanged()
    np.testing.assert_array_equal(turned.other_motion_cost, found.other_motion_cost[:, ::-1])
    np.testing.assert_array_equal(turned.extent_ratio, found.extent_ratio[::-1])
    assert turned.type_costs is found.type_costs, "of two types, not of two parts"


# ---------------------------------------------------------------- what the solver measures


def filmed(pictures, Ts, states, joint):
    """Evidence and the true answer of pictures (rgb, depth, part) of both parts."""
    frames = [Frame(rgb, depth.astype(np.float32), part > 0) for rgb, depth, part in pictures]
    size = pictures[0][2].shape[::-1]
    camera = Camera.from_fov(*size, np.radians(22))
    scene = prepare_scene(Recording(camera, np.arange(len(Ts)) / 30, lambda i: frames[i]), SceneSettings())
    h, w = scene.mask.shape[1:]
    crops = [p[2][y:, x:][:h, :w] for p, (x, y) in zip(pictures, scene.origin, strict=True)]
    labels = np.stack([np.pad(c, [(0, h - c.shape[0]), (0, w - c.shape[1])]) for c in crops])
    poses = JointedPoses(joint, states, Ts, np.zeros(len(Ts)), 0.0)
    logodds = np.where(labels == 2, 3.0, -3.0).astype(np.float32)
    estimate = PartEstimate(poses, labels, logodds, np.ones((len(Ts), 2), bool))
    return Evidence(scene, EvidenceSettings(), LabelSettings()), estimate


def film(first, second, joint, states, third=lambda i: [], turn=0.6, size=(160, 120)):
    """A filmed object whose first part holds, in frame i, the boxes `third(i)` as well."""
    n, rng = len(states), np.random.default_rng(0)
    t = np.linspace(0, 1, n)
    base = se3.exp_so3([0.5, 0.4, 0.1]) @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    Ts = se3.pose(se3.exp_so3(turn * np.sin(3 * t)[:, None] * [0.3, 1, 0.2]) @ base, np.tile([0, 0.02, 1.25], (n, 1)))
    camera, texture = Camera.from_fov(*size, np.radians(22)), rng.uniform(0.25, 1, (3, 12, 12, 12))
    pictures = [
        _render(
            camera,
            (trimesh.util.concatenate([*first, *third(i)]), trimesh.util.concatenate(second)),
            joint,
            Ts[i],
            states[i],
            texture,
        )
        for i in range(n)
    ]
    return filmed(pictures, Ts, np.asarray(states, float), joint)


def unpainted(evidence):
    """The same without colours."""
    scene = replace(evidence.scene, pixels=evidence.scene.pixels.copy())
    scene.features[:] = 0
    return Evidence(scene, evidence.settings, evidence.label_settings)


def both_poses(estimate):
    return np.stack([estimate.poses.Ts, estimate.poses.Ts_moving])


def slider(share):
    """A block that slides along the hinge's base, by up to 20 cm."""
    return [box((0.05, 0.04, 0.06), (-0.1 + 0.2 * share, 0.08, 0.0))]


def test_a_third_motion_is_left_unexplained():
    first, second, joint, (low, high) = OBJECTS["hinge"]
    states = low + (high - low) * (0.5 - 0.5 * np.cos(np.linspace(0, 5, 24)))
    shares = {}
    for moves in (False, True):
        evidence, estimate = film(first, second, joint, states, lambda i, moves=moves: slider(moves * i / 24))
        found = unexplained(evidence, both_poses(estimate), estimate.seen, np.random.default_rng(0))
        shares[moves] = np.nanpercentile(found, 90)
    assert shares[False] < 0.004 and shares[True] > 0.012, shares


def test_a_round_part_follows_the_other_one_as_well():
    """A ball in a fork: how it turns itself cannot be seen, but for its paint; here it has none."""
    ball = trimesh.creation.icosphere(4, 0.08)
    arm = [box((0.02, 0.03, 0.2), (0.11, 0, 0.02)), box((0.05, 0.05, 0.03), (0.11, 0.03, 0.12))]
    joint = Joint("j", "revolute", np.array([0.0, 0, 1]), np.zeros(3), -1, 1)
    evidence, estimate = film([ball], arm, joint, np.sin(np.linspace(0, 5, 20)))
    evidence = unpainted(evidence)
    Ts, rng = both_poses(estimate), np.random.default_rng(0)
    body = body_points(evidence, estimate.labels, Ts[1], estimate.seen[:, 1])
    round_part, arm_part = np.nanmedian(other_motion_cost(evidence, estimate, Ts, body, rng), 0)
    assert round_part < 0.5 < 1.0 < arm_part


def test_a_fan_may_stand_a_wing_further_and_a_lid_may_not():
    wings = [
        box((0.16, 0.04, 0.01), (0, 0, 0)).apply_transform(trimesh.transformations.rotation_matrix(a, [0, 0, 1]))
        for a in np.arange(2) * np.pi / 2
    ]
    mast = [box((0.03, 0.03, 0.1), (0, 0, -0.06)), box((0.2, 0.12, 0.02), (0, 0, -0.12))]
    joint = Joint("j", "revolute", np.array([0.0, 0, 1]), np.zeros(3), -1, 1)
    evidence, estimate = film(mast, wings, joint, np.sin(np.linspace(0, 5, 20)), turn=0.2)
    found = rival_distance(unpainted(evidence), estimate, np.random.default_rng(0))
    tested = found[np.isfinite(found)]
    assert (tested > 0).mean() > 0.7 and np.median(tested[tested > 0]) == pytest.approx(np.pi / 2, abs=np.radians(6))
    clip = make_clip("hinge", 20, (160, 120), spin=0.3)
    pictures = [(f.rgb, f.depth, m) for f, m in zip(map(clip.recording.frame, range(20)), clip.part_masks, strict=True)]
    evidence, estimate = filmed(pictures, clip.Ts, clip.states, clip.joint)
    lid = rival_distance(evidence, estimate, np.random.default_rng(0))
    assert np.mean(lid[np.isfinite(lid)] > 0) < 0.25


@pytest.mark.parametrize("share, decided", [(1.0, True), (0.01, False)])
@pytest.mark.parametrize("name", ["hinge", "slide"])
def test_a_joint_that_hardly_moves_has_a_rival_of_the_other_type(name, share, decided):
    first, second, joint, (low, high) = OBJECTS[name]
    states = low + share * (high - low) * (0.5 - 0.5 * np.cos(np.linspace(0, 5, 20)))
    evidence, estimate = film(first, second, joint, states)
    Ts, settings = both_poses(estimate), ReconstructSettings()
    body = body_points(evidence, estimate.labels, Ts[1], estimate.seen[:, 1])
    rival, (own, other) = find_rival(evidence, estimate.labels, estimate.poses, Ts, estimate.seen, body, settings)
    assert (rival is None) == decided and (other > own + 2 * RIVAL_COST) == decided
    assert rival is None or rival.joint.type != joint.type
    arguments = (evidence, estimate.labels, Ts, estimate.seen, body, np.ones(20, bool), settings)
    chosen = choose_joint_type(*arguments, np.random.default_rng(0))
    assert not decided or chosen.joint.type == joint.type


def with_depth_errors(pictures, sigma, length):
    """The same with normal errors of the depth, metres, blurred over `length` pixels."""
    rng, found = np.random.default_rng(1), []
    for rgb, depth, part in pictures:
        noise = rng.normal(size=depth.shape)
        noise = cv2.GaussianBlur(noise, (0, 0), length) if length else noise
        found.append((rgb, np.where(depth > 0, depth + sigma * noise / noise.std(), 0), part))
    return found


@pytest.mark.parametrize("sigma, length", [(0.0, 0), (0.004, 0), (0.004, 5)])
def test_independent_noise_of_the_depth_is_separated_from_correlated(sigma, length):
    """Of a plate that turns slowly; errors blurred with 5 pixels are correlated as exp(-d^2 / (4 5^2))."""
    clip = make_clip("hinge", 24, (320, 240), spin=0.3)
    frames = [clip.recording.frame(i) for i in range(24)]
    pictures = [(f.rgb, f.depth, m) for f, m in zip(frames, clip.part_masks, strict=True)]
    rgb, depth, _ = (np.stack(images) for images in zip(*with_depth_errors(pictures, sigma, length), strict=True))
    footprint = float(np.median(depth[depth > 0])) / clip.recording.camera.K[0, 0]
    found, area = estimate_correlated_noise(rgb, depth.astype(np.float32), footprint)
    if length:
        assert found == pytest.approx(sigma, rel=0.4) and 80 < area < 700  # 4 pi 5^2 = 314
    else:
        assert (found, area) == (0.0, 1.0)


# ---------------------------------------------------------------- the benchmark


# ---------------------------------------------------------------- the surfaces, drawn over the video


@pytest.fixture(scope="module")
def box_video():
    """The scene of a box that slides in and out of a frame, and its true answer."""
    clip = make_clip("slide", 16, spin=0.5)
    meshes = []
    for boxes in OBJECTS["slide"][:2]:
        solid = trimesh.util.concatenate([b.subdivide_to_size(0.01) for b in boxes])
        meshes.append(Mesh(solid.vertices, solid.faces))
    moving = clip.Ts @ clip.joint.transform(clip.states)
    parts = Articulation(clip.joint, meshes[0], meshes[1])
    seen = np.ones((16, 2), bool)
    answer = Reconstruction(parts, clip.states, clip.Ts, moving, clip.part_masks, seen)
    return prepare_scene(clip.recording, SceneSettings()), answer


def surface_reasons(scene, answer):
    d = replace(sample_diagnostics(len(answer)), **check_surfaces(scene, answer))
    return {part: " ".join(_surface_off_video(d, k)) for k, part in enumerate(PARTS)}


def test_true_surfaces_lie_where_the_video_shows_them(box_video):
    scene, answer = box_video
    found = check_surfaces(scene, answer)
    assert np.isfinite(found["uncovered"]).any() and np.nanmax(found["uncovered"]) < 0.005
    assert np.nanmedian(found["spilled"]) == 0 and np.nanmax(np.nanmedian(found["off_surface"], 0)) < 0.01
    assert np.isnan(found["colour_residual"]).all(), "these meshes have no colours"
    assert (abs(found["extent_ratio"] - 1.1) < 0.4).all()


@pytest.mark.parametrize(
    "fault, words",
    [
        (lambda v, size: v + 0.1 * size * np.array([0.6, 0.48, 0.64]), "off its surface"),
        (lambda v, size: v.mean(0) + 1.3 * (v - v.mean(0)), "off its surface"),
        (lambda v, size: v.mean(0) + 0.7 * (v - v.mean(0)), "lie on neither surface"),
        (lambda v, size: np.where(np.arange(len(v))[:, None] == 0, [0, 0, 97.0], v), "extends over"),
        (lambda v, size: 1000 * v, "extends over"),
    ],
)
@pytest.mark.parametrize("k", [0, 1])
def test_a_surface_that_is_elsewhere_is_doubted(box_video, k, fault, words):
    scene, answer = box_video
    parts = answer.articulation
    mesh = parts.part(PARTS[k])
    wrong = replace(mesh, vertices=fault(mesh.vertices, object_size(answer)))
    answer = replace(answer, articulation=replace(parts, **{PARTS[k]: wrong}))
    assert words in surface_reasons(scene, answer)[PARTS[k]]


def test_a_part_without_surface_is_doubted(box_video):
    scene, answer = box_video
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    found = surface_reasons(scene, replace(answer, articulation=replace(answer.articulation, moving=nothing)))
    assert "of the moving part's pixels lie on neither surface" in found["moving"]


def test_a_part_that_shows_where_it_was_not_recognised_is_doubted(box_video):
    """Its pixels are labelled as the other part's, its state is a guess: only where both were seen all is well."""
    scene, answer = box_video
    lost = np.arange(len(answer)) > 10
    seen, masks, states = answer.seen.copy(), np.array(answer.part_masks), answer.states.copy()
    assert states[lost].min() > 0.04, "else the guess, that it is in, is right"
    seen[lost, 1], states[lost] = False, 0.0
    masks[lost] = np.minimum(masks[lost], 1)
    wrong = replace(answer, seen=seen, part_masks=masks, states=states)
    assert "lie on neither surface" in surface_reasons(scene, wrong)["reference"]
    unmeasured = replace(sample_diagnostics(len(answer)), **check_surfaces(scene, wrong))
    assert np.isnan(unmeasured.off_surface[lost]).all(), "asked of both parts' labels alone"


@pytest.mark.parametrize(
    "low, high, share",
    [
        (0.0, 0.2, 1.0),  # shown while the joint moved
        (0.2, 0.2, 0.75),  # at one state alone: it may as well be the other part's
        (0.1, 0.102, 0.75),  # or nearly so
        (np.inf, -np.inf, 0.75),  # not at all
    ],
)
def test_a_detached_piece_that_was_seen_at_one_state_is_not_known_to_be_its_own(low, high, share):
    """Two boxes side by side, of 3 to 1 in area; the first was shown while the slide moved by 20 cm."""
    first, second = box((0.3, 0.3, 0.3), (0, 0, 0)), box((0.3 / 3**0.5,) * 3, (0.5, 0, 0))
    both = trimesh.util.concatenate([first, second])
    mesh = Mesh(both.vertices, both.faces)
    states = np.repeat([[0.0, low], [0.2, high]], [len(first.vertices), len(second.vertices)], axis=1)
    joint = Joint("j", "prismatic", np.array([0.0, 0, 1]), np.zeros(3), 0, 0.2)
    assert _seen_share(mesh, joint, states, 0.005) == pytest.approx(share)
    hinge = replace(joint, type="revolute", axis=np.array([1.0, 0, 0]), pivot=np.array([0.0, 5.0, 0.0]))
    assert _seen_share(mesh, hinge, states, 0.05) == pytest.approx(share)
    joined = Mesh(mesh.vertices, np.concatenate([mesh.faces, [[0, 1, len(first.vertices)]]]))
    if low < np.inf:
        assert _seen_share(joined, joint, states, 0.005) > 0.999, "what hangs together moves together"
    assert np.isnan(_seen_share(Mesh(np.zeros((0, 3)), np.zeros((0, 3), int)), joint, np.zeros((2, 0)), 0.005))


def test_a_wrong_joint_moves_the_surface_off_the_video(box_video):
    scene, answer = box_video
    joint = answer.articulation.joint
    tilted = replace(joint, axis=se3.exp_so3([0, 0.2, 0.2]) @ joint.axis)
    wrong = replace(answer, articulation=replace(answer.articulation, joint=tilted))
    assert "off its surface" in surface_reasons(scene, wrong)["moving"]
    still = replace(answer, states=np.zeros(len(answer)))
    assert "off its surface" in surface_reasons(scene, still)["moving"]
