"""Adjustment of part poses over pairs of frames: no frame is anchored, every frame counts.

Unknowns are left twists (v, w) of T_camera_part; `Ts` (n, 4, 4) stacks hold them for one part.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.joint import Joint
from freeart21.se3 import Array
from reconstruct.evidence import Evidence, Samples, draw
from reconstruct.settings import PoseSettings

Labels = NDArray[np.uint8]


@dataclass(frozen=True)
class JointedPoses:
    """All poses under one joint; both parts share one canonical frame."""

    joint: Joint
    states: Array
    """(n,) rad or m."""
    Ts: Array
    """(n, 4, 4) T_camera_reference."""
    state_std: Array
    """(n,) standard deviations of the states; inf where nothing was seen."""
    cost: float
    """Mean cost per projected sample: compares hypotheses."""

    @property
    def Ts_moving(self) -> Array:
        """(n, 4, 4) T_camera_moving = T_camera_reference J(q)."""
        return self.Ts @ self.joint.transform(self.states)


@dataclass(frozen=True)
class FreePoses:
    """Poses of one part, unconstrained by any joint."""

    Ts: Array
    """(n, 4, 4) T_camera_part."""
    covariances: Array
    """(n, 6, 6) of the left twists (v, w), the gauge held by the mean."""


def part_samples(
    evidence: Evidence, labels: Labels, part: int, most: int, rng: np.random.Generator, frames: NDArray[np.bool_]
) -> Samples:
    """Usable pixels of one part (1 or 2) in every one of `frames` (n,)."""
    return {i: draw(evidence.usable(i, labels[i] == part), most, rng) for i in map(int, np.flatnonzero(frames))}


def choose_pairs(Ts: Array, seen: NDArray[np.bool_], settings: PoseSettings) -> tuple[NDArray, NDArray]:
    """Directed pairs (source, target) of frames: neighbours in time, and distant frames of a similar view."""
    frames = np.flatnonzero(seen)
    found = {(int(i), int(i) + d) for i in frames for d in settings.offsets if i + d < len(Ts) and seen[i + d]}
    for i in map(int, frames):
        turn = se3.rotation_angle(Ts[frames, :3, :3] @ Ts[i, :3, :3].T)
        chosen: list[int] = []
        for c in np.argsort(turn, kind="stable"):
            j = int(frames[c])
            if len(chosen) >= settings.loops or turn[c] > 0.9:
                break
            if abs(j - i) > 8 and all(abs(j - other) > 3 for other in chosen):
                chosen.append(j)
                found.add((min(i, j), max(i, j)))
    pairs = np.array(sorted(found), int).reshape(-1, 2)
    return np.concatenate([pairs[:, 0], pairs[:, 1]]), np.concatenate([pairs[:, 1], pairs[:, 0]])


def free_adjustment(
    evidence: Evidence,
    labels: Labels,
    part: int,
    Ts: Array,
    seen: NDArray[np.bool_],
    settings: PoseSettings,
    rng: np.random.Generator,
) -> FreePoses:
    """Gauss-Newton over all pairs of one part. Frames without the part keep their pose."""
    n = len(Ts)
    samples = part_samples(evidence, labels, part, settings.samples, rng, seen)
    source, target = choose_pairs(Ts, seen, settings)
    covariances = np.full((n, 6, 6), np.nan)
    if len(source) == 0:
        return FreePoses(Ts, covariances)
    start = Ts
    A = np.zeros((6 * n, 6 * n))
    for _ in range(settings.free_rounds):
        A, b, _ = _normal_equations(evidence, labels, part, Ts, samples, source, target, settings.final_gate)
        step = _damped_solve(A, b).reshape(n, 6)
        Ts = se3.orthonormalised(se3.exp_se3(_limited(step)) @ Ts)
    drift = se3.mean_pose(se3.inverse(start[seen]) @ Ts[seen])
    Ts = np.where(seen[:, None, None], Ts @ se3.inverse(drift), start)
    return FreePoses(Ts, _covariances(A, Ts, seen, len(source) / max(seen.sum(), 1)))


def joint_adjustment(
    evidence: Evidence,
    labels: Labels,
    start: JointedPoses,
    seen: NDArray[np.bool_],
    settings: PoseSettings,
    rng: np.random.Generator,
    rounds: int | None = None,
    within: NDArray[np.bool_] | None = None,
) -> JointedPoses:
    """Gauss-Newton over all poses, one joint and one state a frame, on the pairs of both parts.

    `seen` (n, 2) says where each part can be measured, `within` (n,) which frames take part at all. Without
    `rounds` it runs to the end and measures the standard deviations of the states.
    """
    n, final = len(start.Ts), rounds is None
    rounds = settings.joint_rounds if rounds is None else rounds
    within = np.ones(n, bool) if within is None else within
    usable = seen & within[:, None]
    samples = [part_samples(evidence, labels, k + 1, settings.samples, rng, usable[:, k]) for k in range(2)]
    now = start
    pairs = [choose_pairs(T, usable[:, k], settings) for k, T in enumerate((now.Ts, now.Ts_moving))]
    A, cost = np.zeros((7 * n, 7 * n)), np.inf
    for r in range(rounds):
        gate = max(settings.final_gate, settings.gate * 0.85**r)
        A0, b0, s0 = _normal_equations(evidence, labels, 1, now.Ts, samples[0], *pairs[0], gate)
        A1, b1, s1 = _normal_equations(evidence, labels, 2, now.Ts_moving, samples[1], *pairs[1], gate)
        cost = (s0[2] + s1[2]) / max(s0[1] + s1[1], 1)
        M, across = _joint_jacobian(now)
        A, b = M.T @ A1 @ M, M.T @ b1
        A[: 6 * n, : 6 * n] += A0
        b[: 6 * n] += b0
        _add_state_smoothness(A, b, now.states - start.states)
        now = _stepped(now, _damped_solve(A, b), across, evidence.scene.diagonal)
        if r in (rounds // 3, 2 * rounds // 3):
            pairs = [choose_pairs(T, usable[:, k], settings) for k, T in enumerate((now.Ts, now.Ts_moving))]
    if final:
        reuse = len(pairs[1][0]) / max(usable[:, 1].sum(), 1)
        now = replace(now, state_std=np.where(usable.all(1), _state_std(A, n, reuse), np.inf))
    return replace(now, cost=float(cost))


def _normal_equations(
    evidence: Evidence,
    labels: Labels,
    part: int,
    Ts: Array,
    samples: Samples,
    source: NDArray,
    target: NDArray,
    gate: float,
) -> tuple[Array, Array, Array]:
    """A (6n, 6n), b (6n,) over all frames and summed statistics (4,): inliers, projected, cost, outside.

    With T = T_j T_i^-1 a left twist x_i moves T by -Ad(T) x_i.
    """
    n = len(Ts)
    A, b = np.zeros((n, n, 6, 6)), np.zeros((n, 6))
    if len(source) == 0:
        return A.transpose(0, 2, 1, 3).reshape(6 * n, 6 * n), b.ravel(), np.zeros(4)
    T = Ts[target] @ se3.inverse(Ts[source])
    H, g, stats = evidence.register(source, target, T, samples, gate, labels, part)
    back = -se3.adjoint(T)
    Hb = H @ back
    np.add.at(A, (target, target), H)
    np.add.at(A, (target, source), Hb)
    np.add.at(A, (source, target), np.swapaxes(Hb, 1, 2))
    np.add.at(A, (source, source), np.swapaxes(back, 1, 2) @ Hb)
    np.add.at(b, target, g)
    np.add.at(b, source, np.einsum("pji,pj->pi", back, g))
    return A.transpose(0, 2, 1, 3).reshape(6 * n, 6 * n), b.ravel(), stats.sum(0)


def _joint_jacobian(now: JointedPoses) -> tuple[Array, Array]:
    """M (6n, 7n + m) from (x_i, dq_i, axis, pivot) to left twists of the moving part, and directions across the axis.

    m is 4 for a revolute joint (two of the axis, two of the pivot), 2 for a prismatic one.
    """
    n, joint = len(now.Ts), now.joint
    across = np.linalg.svd(joint.axis[None])[2][1:]
    J = joint.transform(now.states)
    Ad = se3.adjoint(now.Ts)
    eps = 1e-5
    changed = [replace(joint, axis=_unit(joint.axis + eps * a)) for a in across]
    if joint.type == "revolute":
        changed += [replace(joint, pivot=joint.pivot + eps * a) for a in across]
    M = np.zeros((n, 6, 7 * n + len(changed)))
    frames = np.arange(n)
    for q in range(6):
        M[frames, q, 6 * frames + q] = 1
    M[frames, :, 6 * n + frames] = Ad @ joint.screw
    for c, other in enumerate(changed):
        twist = se3.log_se3(other.transform(now.states) @ se3.inverse(J)) / eps
        M[:, :, 7 * n + c] = np.einsum("nij,nj->ni", Ad, twist)
    return M.reshape(6 * n, -1), across


def _stepped(now: JointedPoses, x: Array, across: Array, size: float) -> JointedPoses:
    n, joint = len(now.Ts), now.joint
    Ts = se3.orthonormalised(se3.exp_se3(_limited(x[: 6 * n].reshape(n, 6))) @ now.Ts)
    most = 0.1 if joint.type == "revolute" else 0.1 * size
    states = now.states + np.clip(x[6 * n : 7 * n], -most, most)
    axis = _unit(joint.axis + np.clip(x[7 * n : 7 * n + 2], -0.1, 0.1) @ across)
    pivot = joint.pivot
    if joint.type == "revolute":
        pivot = pivot + np.clip(x[7 * n + 2 :], -0.05 * size, 0.05 * size) @ across
    new = replace(joint, axis=axis, pivot=pivot, lower=float(states.min()), upper=float(states.max()))
    return replace(now, joint=new, states=states, Ts=Ts)


def _add_state_smoothness(A: Array, b: Array, corrections: Array) -> None:
    """A weak pull of the states' corrections (n,) to a straight line: frames without evidence go with their neighbours.

    Not of the states: where nothing is seen, those of the growth are the best there are.
    """
    n = len(corrections)
    if n < 3:
        return
    D = np.zeros((n - 2, n))
    r = np.arange(n - 2)
    D[r, r], D[r, r + 1], D[r, r + 2] = 1, -2, 1
    diagonal = np.diag(A)[6 * n : 7 * n]
    weight = 1e-3 * float(np.median(diagonal[diagonal > 0])) if (diagonal > 0).any() else 1.0
    A[6 * n : 7 * n, 6 * n : 7 * n] += weight * D.T @ D
    b[6 * n : 7 * n] += weight * D.T @ (D @ corrections)


def _damped_solve(A: Array, b: Array) -> Array:
    """The Levenberg-Marquardt step -(A + damping)^-1 b; the damping is what holds the gauge and empty frames."""
    diagonal = np.diag(A)
    floor = 1e-9 * max(float(diagonal.max()), 1e-300)
    damped = A.copy()
    damped[np.diag_indices(len(A))] += 1e-4 * diagonal + floor
    return np.asarray(np.linalg.solve(damped, -b), float)


def _limited(twists: Array) -> Array:
    """Twists (n, 6) cut to 0.1 rad."""
    turn = np.linalg.norm(twists[:, 3:], axis=1)
    shrink = np.minimum(1, 0.1 / np.maximum(turn, 1e-12))
    return twists * shrink[:, None]


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v)


def _covariances(A: Array, Ts: Array, seen: NDArray[np.bool_], reuse: float) -> Array:
    """(n, 6, 6) blocks of the inverse Hessian with the mean gauge twist held; NaN where not seen.

    Each pixel enters about `reuse` pairs, which are not independent: the covariance is that much larger.
    """
    n, frames = len(Ts), np.flatnonzero(seen)
    rows = (6 * frames[:, None] + np.arange(6)).ravel()
    gauge = se3.adjoint(se3.inverse(Ts[frames])).transpose(1, 0, 2).reshape(6, -1) / len(frames)
    B = A[np.ix_(rows, rows)]
    scale = float(np.median(np.diag(B)))
    inverse = np.linalg.pinv(B + scale * gauge.T @ gauge, rcond=1e-12, hermitian=True)
    covariances = np.full((n, 6, 6), np.nan)
    for c, i in enumerate(frames):
        block = inverse[6 * c : 6 * c + 6, 6 * c : 6 * c + 6]
        covariances[i] = 0.5 * reuse * (block + block.T)
    return covariances


def _state_std(A: Array, n: int, reuse: float) -> Array:
    """(n,) standard deviations of the states against their mean, all else free."""
    scale = np.sqrt(np.maximum(np.diag(A), 1e-12 * np.diag(A).max()))
    normed = A / scale[:, None] / scale[None]
    inverse = np.linalg.pinv(normed, rcond=1e-9, hermitian=True)
    variance = np.diag(inverse)[6 * n : 7 * n] / scale[6 * n : 7 * n] ** 2
    return np.sqrt(np.maximum(reuse * variance, 0))
