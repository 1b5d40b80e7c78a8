"""The compiled Gauss-Newton of a frame against its definition in numpy, on a clip with known poses."""

import numpy as np
import pytest
from reconstruct_clip import make_clip

from freeart21 import se3
from reconstruct import registration
from reconstruct.evidence import Evidence, PartReferences, sample_pixels
from reconstruct.scene import prepare_scene
from reconstruct.settings import ReconstructSettings

FRAME, OTHERS, GATES = 4, np.array([1, 2, 6, 7]), (9.0, 6.0, 4.0)
PUSH = se3.exp_se3([0.002, -0.001, 0.003, 0.01, 0.015, -0.01])


@pytest.fixture(scope="module")
def case():
    """The clip, its evidence, and per part its true poses and what frame FRAME is registered to."""
    clip, rng = make_clip("hinge", 10, spin=0.2), np.random.default_rng(0)
    scene, settings = prepare_scene(clip.recording, ReconstructSettings().scene), ReconstructSettings()
    evidence = Evidence(scene, settings.evidence, settings.labels)
    h, w = scene.mask.shape[1:]
    corners = zip(clip.part_masks, scene.origin, strict=True)
    labels = np.stack([mask[y : y + h, x : x + w] for mask, (x, y) in corners]).astype(np.uint8)
    Ts = np.stack([clip.Ts, clip.Ts @ clip.joint.transform(clip.states)])
    references = []
    for k in range(2):
        samples = {int(i): sample_pixels(labels[i] == k + 1, 300, rng) for i in OTHERS}
        references.append(PartReferences(OTHERS, se3.inverse(Ts[k, OTHERS]), evidence.records(samples)))
    return clip, evidence, labels, Ts, references


def terms(case, k, T, gate):
    """Summed Gauss-Newton terms and statistics of part k at `T`."""
    _, evidence, labels, _, references = case
    relative, known = T @ references[k].Ts_part, references[k]
    found = evidence.register(OTHERS, np.full(len(OTHERS), FRAME), relative, known.records, gate, labels, k + 1)
    return [values.sum(0) for values in found]


def damped_step(A, b):
    diagonal = np.diag(A)
    x = -np.linalg.solve(A + np.diag(1e-3 * diagonal + 1e-9 * diagonal.max()), b)
    x[:6] *= min(1.0, registration.MAX_TURN / max(np.linalg.norm(x[3:6]), 1e-12))
    return x


@pytest.mark.parametrize("k", [0, 1])
def test_a_pose_takes_one_damped_step_a_gate_towards_the_truth(case, k):
    _, evidence, labels, Ts, references = case
    start = T = PUSH @ Ts[k, FRAME]
    for gate in GATES:
        A, b, statistics = terms(case, k, T, gate)
        T = se3.orthonormalised(se3.exp_se3(damped_step(A, b)) @ T)
    found, of_last_gate = evidence.register_pose(start, FRAME, references[k], GATES, labels, k + 1)
    np.testing.assert_allclose(found, T, atol=1e-11)
    np.testing.assert_allclose(of_last_gate, statistics, rtol=1e-9)
    assert np.abs(found - Ts[k, FRAME]).max() < 0.8 * np.abs(start - Ts[k, FRAME]).max()


@pytest.mark.parametrize("at_rest", [False, True])
def test_pose_and_state_take_one_damped_step_a_gate(case, at_rest):
    clip, evidence, labels, Ts, references = case
    q0 = q = float(clip.states[FRAME]) + 0.03
    start = T = PUSH @ Ts[0, FRAME]
    weight, expected, most = 50.0, q0 - 0.01, 0.02
    for gate in GATES:
        A, b = np.zeros((7, 7)), np.zeros(7)
        A[6, 6], b[6] = weight, weight * (q - expected)
        for k in range(2):
            H, g, _ = terms(case, k, T @ clip.joint.transform(q) if k else T, gate)
            M = np.eye(6, 7)
            M[:, 6] = se3.adjoint(T) @ clip.joint.screw if k else 0
            A += M.T @ H @ M
            b += M.T @ g
        if at_rest:
            A[6], A[:, 6], b[6] = 0, 0, 0
        x = damped_step(A, b)
        T, q = se3.orthonormalised(se3.exp_se3(x[:6]) @ T), q + float(np.clip(x[6], -most, most))
    arguments = clip.joint, FRAME, tuple(references), GATES, labels, (weight, expected), most, at_rest
    found, state = evidence.register_jointed_pose(start, q0, *arguments)
    np.testing.assert_allclose(found, T, atol=1e-11)
    assert state == pytest.approx(q, abs=1e-11)
    assert (state == q0) == at_rest


def test_without_evidence_nothing_moves(case):
    _, evidence, labels, Ts, _ = case
    empty = PartReferences(OTHERS[:0], np.zeros((0, 4, 4)), evidence.records({}))
    found, statistics = evidence.register_pose(Ts[0, FRAME], FRAME, empty, GATES, labels, 1)
    np.testing.assert_allclose(found, Ts[0, FRAME], atol=1e-15)
    assert not statistics.any()
