"""Adjustment of all part poses over frame pairs. No frame is fixed.

Unknowns are left twists (v, w) of T_camera_part; the stack `Ts` (n, 4, 4) holds one part's poses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from freeart21 import se3
from freeart21.joint import Joint
from freeart21.se3 import Array
from reconstruct.evidence import Evidence, Records, Samples, sample_pixels
from reconstruct.rigid import view_angle
from reconstruct.scene import Scene
from reconstruct.settings import PoseSettings

Labels = NDArray[np.uint8]

OFFSETS = (1, 2, 4, 7, 11)
"""Frame distances of pairs along time."""
SAMPLES = 500
"""Pixels per frame and part."""
GATE, FINAL_GATE = 9.0, 4.0
"""First and last point-to-plane gate of the adjustment under a joint."""
JOINT_ROUNDS, FREE_ROUNDS = 14, 8
"""Iterations of the adjustment under a joint, and without."""
AXIS_FACTOR = 2.8
"""Factor on the axis's standard deviation from noise and SYSTEMATIC: root mean square of error over deviation, of 19
answers to 18 recordings (unlit, 320 x 180, 40 to 60 frames, clean, tof, noise2 and hand, 16 objects, two not ours,
without Gaussians), divided by sqrt(2) for the axis's two tilts. Half of the errors were below 1.1 deviations, four
beyond 4 (4.4, 5.6, 7.7, 12.5); of the 11 answers that `trust` finds sound, one (4.4). The axis line needed no factor:
seven sound answers up to 2.2, root mean square 1.1. For lit videos the factor is too large: 8 right answers of
benchmarks/trust.py erred by up to 1.8 deviations without it, 13 with Gaussians by up to 2.5."""
_SINGULAR = 1e-12
"""Eigenvalues below this share of the largest count as zero."""
SYSTEMATIC = 1 / 3
"""Systematic error of a part's pose, in units of `Evidence.unit`: rims, creases and labels err equally in all frames.
Eight right answers of benchmarks/trust.py had errors of 4 (median) to 9 deviations of the noise alone: 0.1 to 1.3
degrees where the noise explains 0.05 to 0.3. With this they have about 1. States of noisy sensors were off by 3 to 9
deviations of the noise alone, with Gaussians by 2.6 to 5; of four of six clean recordings by less than one already, so
that their deviations are now too large. Of 21 right answers (clean, tof, noise2, hand, 16 objects, without Gaussians)
89 % of the states were within two deviations, 93 % but for one mixer whose states are off by 8."""


@dataclass(frozen=True)
class JointedPoses:
    """Poses of both parts under one joint, in one canonical frame."""

    joint: Joint
    states: Array
    """(n,) rad or m."""
    Ts: Array
    """(n, 4, 4) T_camera_reference."""
    state_std: Array
    """(n,) standard deviations of the states; inf where a part was not seen."""
    cost: float
    """Mean cost per projected sample, to compare joints."""
    joint_std: Array | None = None
    """(2, 2) standard deviations in the frame of the first and of the second part: of the axis direction, rad, and of
    the axis line at the second part, metres (NaN for a prismatic joint). None when not estimated. See `_joint_std` and
    `_systematic_std`."""

    @property
    def Ts_moving(self) -> Array:
        """(n, 4, 4) T_camera_moving = T_camera_reference J(q)."""
        return self.Ts @ self.joint.transform(self.states)


@dataclass(frozen=True)
class FreePoses:
    """Poses of one part without a joint."""

    Ts: Array
    """(n, 4, 4) T_camera_part."""
    covariances: Array
    """(n, 6, 6) of the left twists (v, w), with their mean fixed."""


def part_samples(
    evidence: Evidence, labels: Labels, part: int, most: int, rng: np.random.Generator, frames: NDArray[np.bool_]
) -> Samples:
    """Usable pixels of one part (1 or 2) in each of `frames` (n,)."""
    return {
        i: sample_pixels(evidence.usable_pixels(i, labels[i] == part), most, rng)
        for i in map(int, np.flatnonzero(frames))
    }


def choose_pairs(Ts: Array, seen: NDArray[np.bool_], settings: PoseSettings) -> tuple[NDArray[Any], NDArray[Any]]:
    """Directed pairs (source, target) of frames: neighbours in time, and distant frames of a similar view."""
    frames = np.flatnonzero(seen)
    found = {(int(i), int(i) + d) for i in frames for d in OFFSETS if i + d < len(Ts) and seen[i + d]}
    for i in map(int, frames):
        turn = view_angle(Ts[frames, :3, :3], Ts[i, :3, :3])
        near = (turn <= 0.9) & (np.abs(frames - i) > 8)
        remaining = frames[near][np.argsort(turn[near], kind="stable")]
        for _ in range(settings.loops):
            if len(remaining) == 0:
                break
            j = int(remaining[0])
            found.add((min(i, j), max(i, j)))
            remaining = remaining[np.abs(remaining - j) > 3]
    pairs = np.array(sorted(found), int).reshape(-1, 2)
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.argsort(both[:, 1], kind="stable")]  # by target: its picture is then at hand for all its sources
    return both[:, 0], both[:, 1]


def free_adjustment(
    evidence: Evidence,
    labels: Labels,
    part: int,
    Ts: Array,
    seen: NDArray[np.bool_],
    settings: PoseSettings,
    rng: np.random.Generator,
) -> FreePoses:
    """Gauss-Newton over all pairs of one part. Frames that do not show it keep their pose."""
    n = len(Ts)
    samples = evidence.records(part_samples(evidence, labels, part, SAMPLES, rng, seen))
    source, target = choose_pairs(Ts, seen, settings)
    covariances = np.full((n, 6, 6), np.nan)
    if len(source) == 0:
        return FreePoses(Ts, covariances)
    start = Ts
    A = sparse.csr_array((6 * n, 6 * n))
    for _ in range(FREE_ROUNDS):
        A, b, _ = _normal_equations(evidence, labels, part, Ts, samples, source, target, FINAL_GATE)
        step = solve_damped(A, b).reshape(n, 6)
        Ts = se3.orthonormalised(se3.exp_se3(limit_rotations(step)) @ Ts)
    drift = se3.mean_pose(se3.inverse(start[seen]) @ Ts[seen])
    Ts = np.where(seen[:, None, None], Ts @ se3.inverse(drift), start)
    pairs_per_pixel = len(source) / max(seen.sum(), 1)
    return FreePoses(Ts, _covariances(A, Ts, seen, pairs_per_pixel))


def joint_adjustment(
    evidence: Evidence,
    labels: Labels,
    start: JointedPoses,
    seen: NDArray[np.bool_],
    settings: PoseSettings,
    rng: np.random.Generator,
    rounds: int | None = None,
    within: NDArray[np.bool_] | None = None,
    samples: int = SAMPLES,
    gate: float = GATE,
) -> JointedPoses:
    """Gauss-Newton over all poses, one joint and one state per frame, on the pairs of both parts.

    `seen` (n, 2) says where each part can be measured, `within` (n,) which frames take part. `gate` is the first gate,
    in units. Without `rounds` it runs JOINT_ROUNDS and estimates standard deviations.
    """
    n, final = len(start.Ts), rounds is None
    rounds = JOINT_ROUNDS if rounds is None else rounds
    within = np.ones(n, bool) if within is None else within
    usable = seen & within[:, None]
    pixels = [part_samples(evidence, labels, k + 1, samples, rng, usable[:, k]) for k in range(2)]
    records = [evidence.records(part) for part in pixels]
    current = start
    pairs = [choose_pairs(T, usable[:, k], settings) for k, T in enumerate((current.Ts, current.Ts_moving))]
    A, cost = sparse.csr_array((7 * n, 7 * n)), np.inf
    for r in range(rounds):
        round_gate = max(FINAL_GATE, gate * 0.85**r)
        A0, b0, s0 = _normal_equations(evidence, labels, 1, current.Ts, records[0], *pairs[0], round_gate)
        A1, b1, s1 = _normal_equations(evidence, labels, 2, current.Ts_moving, records[1], *pairs[1], round_gate)
        cost = (s0[2] + s1[2]) / max(s0[1] + s1[1], 1)
        M, across = joint_jacobian(current)
        own = sparse.eye_array(6 * n, M.shape[1], format="csr")
        A, b = own.T @ A0 @ own + M.T @ A1 @ M, own.T @ b0 + M.T @ b1
        step = solve_damped(*add_state_smoothness(A, b, current.states - start.states))
        current = apply_joint_step(current, step, across, evidence.scene.diagonal)
        if r in (rounds // 3, 2 * rounds // 3):
            pairs = [choose_pairs(T, usable[:, k], settings) for k, T in enumerate((current.Ts, current.Ts_moving))]
    if final:
        pairs_per_pixel = len(pairs[1][0]) / max(usable[:, 1].sum(), 1)
        clouds = [_sample_points(evidence.scene, pixels[k], T) for k, T in enumerate((current.Ts, current.Ts_moving))]
        current = add_standard_deviations(current, A.toarray(), usable, clouds, pairs_per_pixel, evidence.unit)
    return replace(current, cost=float(cost))


def add_standard_deviations(
    current: JointedPoses, A: Array, usable: NDArray[np.bool_], clouds: list[Array], pairs_per_pixel: float, unit: float
) -> JointedPoses:
    """`current` with standard deviations of states and joint from the normal matrix A (7n + m, 7n + m) and systematic
    errors.

    `usable` (n, 2) says where the parts were measured; `clouds` are points (p, 3) of theirs in their own frames. Each
    residual was counted about `pairs_per_pixel` times. Systematic errors are proportional to `unit`, metres.
    """
    measured = np.asarray(usable.all(1))
    noise = _joint_std(A.copy(), current, usable, clouds[1].mean(0), pairs_per_pixel)
    systematic = _systematic_std(clouds, unit)
    joint_std = np.hypot(noise, systematic) * [AXIS_FACTOR, 1.0]
    by_noise = _state_std(A.copy(), measured, pairs_per_pixel)
    state_std = np.hypot(by_noise, systematic[0 if current.joint.type == "revolute" else 1])
    state_std = np.where(measured, state_std, np.inf)
    return replace(current, state_std=state_std, joint_std=joint_std)


def _normal_equations(
    evidence: Evidence,
    labels: Labels,
    part: int,
    Ts: Array,
    samples: Records,
    source: NDArray[Any],
    target: NDArray[Any],
    gate: float,
) -> tuple[sparse.csr_array, Array, Array]:
    """A (6n, 6n), b (6n,) over all frames, and summed statistics (4,): inliers, projected, cost, outside.

    With T = T_j T_i^-1 a left twist x_i moves T by -Ad(T) x_i. A has blocks for the pairs only.
    """
    n = len(Ts)
    if len(source) == 0:
        return sparse.csr_array((6 * n, 6 * n)), np.zeros(6 * n), np.zeros(4)
    T = Ts[target] @ se3.inverse(Ts[source])
    H, g, stats = evidence.register(source, target, T, samples, gate, labels, part)
    by_source = -se3.adjoint(T)
    Hb = H @ by_source
    to_target, to_source = (_summation_matrix(frames, n) for frames in (target, source))
    own = to_target @ H.reshape(-1, 36) + to_source @ (np.swapaxes(by_source, 1, 2) @ Hb).reshape(-1, 36)
    b = to_target @ g + to_source @ np.einsum("pji,pj->pi", by_source, g)
    A = _from_blocks(
        np.concatenate([np.arange(n), target, source]),
        np.concatenate([np.arange(n), source, target]),
        np.concatenate([own.reshape(n, 6, 6), Hb, np.swapaxes(Hb, 1, 2)]),
        n,
    )
    return A, b.ravel(), stats.sum(0)


def _summation_matrix(frames: NDArray[Any], n: int) -> sparse.csr_array:
    """(n, p) matrix that sums values of pairs over the pairs of each frame."""
    return sparse.csr_array((np.ones(len(frames)), (frames, np.arange(len(frames)))), (n, len(frames)))


def _from_blocks(rows: NDArray[Any], columns: NDArray[Any], blocks: Array, n: int) -> sparse.csr_array:
    """(6n, 6n) matrix of blocks (k, 6, 6) at block rows and columns (k,); blocks at the same place add up."""
    order = np.argsort(rows, kind="stable")
    starts = np.searchsorted(rows[order], np.arange(n + 1))
    return sparse.bsr_array((blocks[order], columns[order], starts), (6 * n, 6 * n)).tocsr()


def joint_jacobian(current: JointedPoses) -> tuple[sparse.csr_array, Array]:
    """M (6n, 7n + m) from (x_i, dq_i, axis, pivot) to left twists of the moving part, and two directions across the
    axis.

    m is 4 for a revolute joint (two for the axis, two for the pivot), 2 for a prismatic one.
    """
    n, joint = len(current.Ts), current.joint
    across = np.linalg.svd(joint.axis[None])[2][1:]
    J = joint.transform(current.states)
    Ad = se3.adjoint(current.Ts)
    eps = 1e-5
    changed = [replace(joint, axis=_unit(joint.axis + eps * a)) for a in across]
    if joint.type == "revolute":
        changed += [replace(joint, pivot=joint.pivot + eps * a) for a in across]
    twists = [se3.log_se3(other.transform(current.states) @ se3.inverse(J)) / eps for other in changed]
    shared = np.einsum("nij,cnj->nic", Ad, twists).reshape(6 * n, len(changed))
    of_frame = np.repeat(np.arange(n), 6)
    states = sparse.csr_array(((Ad @ joint.screw).ravel(), of_frame, np.arange(6 * n + 1)), (6 * n, n))
    return sparse.hstack([sparse.eye_array(6 * n), states, shared], format="csr"), across


def apply_joint_step(current: JointedPoses, x: Array, across: Array, size: float) -> JointedPoses:
    """`current` after a limited step x (7n + m,) of `joint_jacobian`'s unknowns; `size` is the object's, metres."""
    n, joint = len(current.Ts), current.joint
    Ts = se3.orthonormalised(se3.exp_se3(limit_rotations(x[: 6 * n].reshape(n, 6))) @ current.Ts)
    most = 0.1 if joint.type == "revolute" else 0.1 * size
    states = current.states + np.clip(x[6 * n : 7 * n], -most, most)
    axis = _unit(joint.axis + np.clip(x[7 * n : 7 * n + 2], -0.1, 0.1) @ across)
    pivot = joint.pivot
    if joint.type == "revolute":
        pivot = pivot + np.clip(x[7 * n + 2 :], -0.05 * size, 0.05 * size) @ across
    new = replace(joint, axis=axis, pivot=pivot).spanning(states)
    return replace(current, joint=new, states=states, Ts=Ts)


def add_state_smoothness(A: sparse.csr_array, b: Array, corrections: Array) -> tuple[sparse.csr_array, Array]:
    """A and b with a weak prior that the states' corrections (n,) are linear in time.

    Frames without evidence then follow their neighbours. The prior is on corrections, not states: where nothing is
    seen, the states of the propagation are the best guess.
    """
    n = len(corrections)
    if n < 3:
        return A, b
    D = sparse.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(n - 2, n))
    diagonal = A.diagonal()[6 * n : 7 * n]
    weight = 1e-3 * float(np.median(diagonal[diagonal > 0])) if (diagonal > 0).any() else 1.0
    bend = sparse.hstack([sparse.csr_array((n - 2, 6 * n)), D, sparse.csr_array((n - 2, len(b) - 7 * n))], format="csr")
    return A + weight * bend.T @ bend, b + weight * bend.T @ (D @ corrections)


def solve_damped(A: sparse.csr_array, b: Array, damping: float = 1e-4) -> Array:
    """The Levenberg-Marquardt step -(A + damping)^-1 b; damping fixes the gauge and empty frames.

    A is symmetric and, damped, positive definite: its factors need no pivoting.
    """
    diagonal = A.diagonal()
    floor = 1e-9 * max(float(diagonal.max()), 1e-300)
    damped = (A + sparse.diags_array(damping * diagonal + floor)).tocsc()
    return np.asarray(
        splu(damped, diag_pivot_thresh=0.0, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(-b),
        float,
    )


def limit_rotations(twists: Array) -> Array:
    """Twists (n, 6) cut to 0.1 rad."""
    turn = np.linalg.norm(twists[:, 3:], axis=1)
    shrink = np.minimum(1, 0.1 / np.maximum(turn, 1e-12))
    return twists * shrink[:, None]


def _unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v), float)


def _covariances(A: sparse.csr_array, Ts: Array, seen: NDArray[np.bool_], pairs_per_pixel: float) -> Array:
    """(n, 6, 6) blocks of the inverse Hessian with the mean twist fixed; NaN where not seen.

    Each pixel enters about `pairs_per_pixel` dependent pairs, which scales the covariance.
    """
    n, frames = len(Ts), np.flatnonzero(seen)
    rows = (6 * frames[:, None] + np.arange(6)).ravel()
    gauge = se3.adjoint(se3.inverse(Ts[frames])).transpose(1, 0, 2).reshape(6, -1) / len(frames)
    B = A[rows][:, rows].toarray()
    scale = float(np.median(np.diag(B)))
    held = B + scale * gauge.T @ gauge
    inverse = _inverse(held)
    if inverse is None:
        inverse = np.linalg.pinv(held, rcond=_SINGULAR, hermitian=True)
    covariances = np.full((n, 6, 6), np.nan)
    for c, i in enumerate(frames):
        block = inverse[6 * c : 6 * c + 6, 6 * c : 6 * c + 6]
        covariances[i] = 0.5 * pairs_per_pixel * (block + block.T)
    return covariances


def _state_std(A: Array, measured: NDArray[np.bool_], pairs_per_pixel: float) -> Array:
    """(n,) standard deviations of the `measured` (n,) states against their mean, with all else free; the rest is
    undefined."""
    n = len(measured)
    unknown = 6 * n + np.flatnonzero(~measured)
    A[unknown], A[:, unknown] = 0, 0
    scale = np.sqrt(np.maximum(np.diag(A), 1e-12 * np.diag(A).max()))
    normed = A / scale[:, None] / scale[None]
    frame = int(np.argmax(np.diag(A)[6 * n : 7 * n]))
    variances = _gauge_free_variances(normed, np.append(6 * frame + np.arange(6), 6 * n + frame))
    if variances is None:
        variances = np.diag(np.linalg.pinv(normed, rcond=1e-9, hermitian=True))
    return np.sqrt(np.maximum(pairs_per_pixel * variances[6 * n : 7 * n] / scale[6 * n : 7 * n] ** 2, 0))


def _sample_points(scene: Scene, samples: Samples, Ts: Array) -> Array:
    """(p, 3) sampled points of a part in its own frame; the origin when there are none."""
    points = scene.points
    clouds = [se3.transform(se3.inverse(Ts[i]), points[i, p[:, 0], p[:, 1]]) for i, p in samples.items() if len(p)]
    return np.asarray(np.concatenate(clouds), float) if clouds else np.zeros((1, 3))


def _systematic_std(clouds: list[Array], unit: float) -> Array:
    """(2,) standard deviations of axis, rad, and axis line, metres, for pose errors of SYSTEMATIC `unit`s, metres.

    A part turns by such an error over its extent: twice the rms distance of its points (p, 3) from their mean.
    """
    extents = [2 * float(np.sqrt(((c - c.mean(0)) ** 2).sum(1).mean())) for c in clouds]
    tilts = [SYSTEMATIC * unit / max(extent, unit) for extent in extents]
    return np.array([np.hypot(tilts[0], tilts[1]), np.sqrt(2) * SYSTEMATIC * unit])


def _joint_std(
    A: Array, current: JointedPoses, seen: NDArray[np.bool_], centre: Array, pairs_per_pixel: float
) -> Array:
    """(2, 2) standard deviations of the joint from noise, in the frame of either part; see `JointedPoses.joint_std`.

    `A` (7n + m, 7n + m) are the normal equations of all unknowns with the joint's m last, `seen` (n, 2) where each part
    was measured, `centre` (3,) the second part's. All frames and states are free except for what the video cannot
    determine: the part's mean twist in its own frame and the mean state are fixed by Lagrange multipliers. Both figures
    are rms over two directions across the axis: the two tilts, and the two shifts of the axis line at its point nearest
    the centre.
    """
    n, count = len(current.Ts), len(A) - 7 * len(current.Ts)
    unknown = 6 * n + np.flatnonzero(~seen.all(1))  # the pose makes up for any such state: the matrix would be singular
    A = A.copy()
    A[unknown], A[:, unknown] = 0, 0
    M, _ = joint_jacobian(current)
    scale = np.sqrt(np.where(np.diag(A) > 0, np.diag(A), 1.0))
    normed = A / scale[:, None] / scale[None]
    np.fill_diagonal(normed, np.where(np.diag(A) > 0, np.diag(normed), 1.0))
    mean_state = np.zeros(len(A))
    mean_state[6 * n : 7 * n] = seen.all(1)
    found = np.full((2, 2), np.nan)
    for k, Ts in enumerate((current.Ts, current.Ts_moving)):
        frames = np.flatnonzero(seen[:, k])
        if not len(frames) or not seen.all(1).any():
            continue
        mean_twist = np.zeros((6, 6 * n))
        for i in frames:
            mean_twist[:, 6 * i : 6 * i + 6] = se3.adjoint(se3.inverse(Ts[i]))
        own = np.eye(6 * n, len(A)) if k == 0 else M.toarray()
        held = np.vstack([mean_twist @ own, mean_state]) / scale
        held /= np.maximum(np.linalg.norm(held, axis=1, keepdims=True), 1e-300)
        system = np.block([[normed, held.T], [held, np.zeros((7, 7))]])
        right_hand_side = np.zeros((len(system), count))
        right_hand_side[7 * n : len(A)] = np.eye(count)
        try:
            solved = np.linalg.solve(system, right_hand_side)
        except np.linalg.LinAlgError:  # the video tells nothing of the joint
            continue
        covariance = pairs_per_pixel * solved[7 * n : len(A)] / scale[7 * n :, None] / scale[None, 7 * n :]
        found[k, 0] = np.sqrt(max(np.trace(covariance[:2, :2]) / 2, 0.0))
        if count == 4:
            along = float((centre - current.joint.pivot) @ current.joint.axis)
            to_line = np.hstack([along * np.eye(2), np.eye(2)])
            found[k, 1] = np.sqrt(max(np.trace(to_line @ covariance @ to_line.T) / 2, 0.0))
    return found


def _gauge_free_variances(A: Array, gauge: NDArray[np.int64]) -> Array | None:
    """The diagonal of A's pseudo-inverse; None unless A is regular with the unknowns `gauge` fixed.

    A third of the time of an eigendecomposition. With the gauge fixed, the inverse G of the rest is a generalised
    inverse of A, and the rest's response to a move of the gauge spans A's null space N: A+ = (I - N N^T) G (I - N N^T).
    """
    seen = np.diag(A) > 0
    rest = seen.copy()
    rest[gauge] = False
    inverse = _inverse(A[np.ix_(rest, rest)])
    if inverse is None:
        return None
    G, N = np.zeros_like(A), np.zeros((len(A), len(gauge)))
    G[np.ix_(rest, rest)] = inverse
    N[rest], N[gauge] = -inverse @ A[np.ix_(rest, gauge)], np.eye(len(gauge))
    N = np.linalg.qr(N)[0]
    if np.abs(A @ N).max() > 1e-9:  # fewer unknowns than these are free
        return None
    GN = G @ N
    return np.asarray(np.diag(G) - 2 * (GN * N).sum(1) + (N @ (N.T @ GN) * N).sum(1), float)


def _inverse(A: Array) -> Array | None:
    """The inverse of a matrix; None when it is numerically singular."""
    try:
        inverse = np.linalg.inv(A)
    except np.linalg.LinAlgError:
        return None
    condition = np.linalg.norm(A, 1) * np.linalg.norm(inverse, 1) if len(A) else 1.0
    return np.asarray(inverse, float) if condition < 1 / _SINGULAR else None
