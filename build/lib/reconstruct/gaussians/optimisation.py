"""End-to-end optimisation (paper, End-to-end Optimization): Adam over the Gaussians, Gauss-Newton over the motion.

A round shows the model every frame once. The Gaussians take a step at every frame; poses, states, axis and pivot take
one together at its end, from what all frames said. Some frames are held back: the model never learns from them, and
what was found of the motion is kept only if they are explained better than with the motion that was there before.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import solve

from freeart21 import se3
from freeart21.gaussians import Gaussians
from freeart21.mesh import Mesh
from freeart21.recording import Recording
from freeart21.se3 import Array
from reconstruct.gaussians.adam import Adam
from reconstruct.gaussians.alignment import Reduced, Scales, Terms, alignment_terms, cells_of, reduced
from reconstruct.gaussians.backends import choose
from reconstruct.gaussians.density import grown_and_pruned
from reconstruct.gaussians.initial import discs
from reconstruct.gaussians.losses import COVERED, Loss, loss
from reconstruct.gaussians.model import Back, splats_of
from reconstruct.gaussians.rasteriser import Picture, Pull, Rasterise
from reconstruct.gaussians.windows import Windows, windows_of
from reconstruct.growth import Grown
from reconstruct.labels import SURE
from reconstruct.poses import (
    FreePoses,
    JointedPoses,
    joint_jacobian,
    limited,
    stepped,
    with_state_smoothness,
    with_std,
)
from reconstruct.scene import Scene
from reconstruct.settings import GaussianSettings, ReconstructSettings
from reconstruct.surfaces import fuse

Flags = NDArray[np.bool_]

SHORTEST_ROUND = 150
"""Pictures of a round, at least: shorter videos are shown again, so that the model keeps up with the motion."""
DAMPING = 1e-6
"""Of the Gauss-Newton steps: a drift along the video has eigenvalues of 1e-4 of the diagonal."""
COARSE = ((0.4, 4), (0.7, 2), (1.0, 1))
"""Until which share of the rounds how many pixels each way are taken as one: at once in full, the first step goes 16 %
of the way, with 4 pixels 40 % (noise2 swivel_usb)."""
FREE_STEPS, FREE_COARSE = 2, 2
"""Gauss-Newton steps of a part's pose without the joint, and the pixels each way that they take as one."""
FARTHEST = 20
"""Footprints that a patch goes in a step, at most."""
MOST_APART = 1.5
"""By how much the depth pictures may disagree more, squared, under the refined motion. Under the true one they do by
1.03 to 1.12 times in seven recordings of a clean and a noisy sensor, and by more where a sensor errs alike in many
frames (2.7 and 4.8, time of flight). Refined motions that were two to six times as good had 1.07 to 1.26; the clean
torch_lighter's, whose states were right to .03 degrees and drifted by .15 along the video while held-back pictures were
explained better, 1.7 to 1.9."""
SURELY = 2.0
"""Standard errors by which the frames held back must be explained better."""
SHOWN = 0.02
"""Pixels that a Gaussian covers by itself, from which a picture shows it."""
TRIAL_STEPS = 3
"""Gauss-Newton steps that bring a held-back frame to a model before it is judged."""


@dataclass(frozen=True)
class Optimised:
    """What the stage found."""

    poses: JointedPoses
    free: tuple[FreePoses, FreePoses]
    """Both parts' poses as the model has them without the joint."""
    gaussians: Gaussians
    """In the frame of `poses`, joint state zero."""
    shares: NDArray[np.float32]
    """(n, h, w) of the scene's crops, how much of what the model shows there is the moving part's, 0 to 1; NaN where it
    shows nothing."""
    kept: bool
    """Whether the motion is the refined one."""

    def in_place_of(self, grown: Grown) -> Grown:
        """`grown` with the motion that was found, and with the part masks that the model has under it.

        With labels of the time-of-flight swivel_usb, mIoU .807, the model settled on such of .945; poses that were not
        refined leave the labels as they were.
        """
        if not self.kept:
            return grown
        read = np.isfinite(self.shares) & (grown.labels > 0)
        labels = np.where(read, np.where(self.shares > 0.5, 2, 1), grown.labels).astype(np.uint8)
        logodds = np.where(read, 2 * SURE * (self.shares - 0.5), grown.logodds).astype(np.float32)
        return replace(grown, labels=labels, logodds=logodds, poses=replace(self.poses, cost=grown.poses.cost))


def optimise(
    recording: Recording,
    scene: Scene,
    grown: Grown,
    settings: ReconstructSettings,
    rng: np.random.Generator,
    progress: Callable[[float], object] = lambda share: None,
    apart: Callable[[JointedPoses], float] = lambda poses: 0.0,
) -> Optimised | None:
    """The articulated model of a video, and its motion refined; None where no part has a surface to begin with.

    `progress` is told the share that is done. `apart` says by how much, squared, the depth pictures of a video disagree
    under a motion, whatever a model makes of them.
    """
    s = settings.gaussians
    windows = windows_of(recording, scene, s.most_pixels)
    held = _held_back(windows.shown, s.held_back)
    train = windows.shown & ~held
    seed = int(rng.integers(2**32))

    def surfaces(poses: JointedPoses) -> list[Mesh]:
        Ts = (poses.Ts, poses.Ts_moving)
        return [fuse(scene, grown.labels, k + 1, Ts[k], grown.seen[:, k], settings.surfaces) for k in range(2)]

    def begun(poses: JointedPoses, meshes: list[Mesh]) -> Fit:
        """A model that has learned a motion for as long as the warm-up is."""
        fit = Fit(windows, (meshes[0], meshes[1]), poses, choose(s.backend), s, np.random.default_rng(seed))
        fit.coarseness = COARSE[0][1]
        for r in range(s.warm_up):
            fit.round(train, r / s.rounds, (r + 1) / s.rounds)
        return fit

    meshes = surfaces(grown.poses)
    if all(mesh.empty for mesh in meshes):
        return None
    fit = begun(grown.poses, meshes)
    before = fit.copy()
    for r in range(s.warm_up, s.rounds):
        progress(r / s.rounds)
        fit.coarseness = next(c for until, c in COARSE if r < until * s.rounds)
        if s.end_to_end:
            fit.adjust(train, held, s.momentum if r < 0.7 * s.rounds else s.momentum / 2)
        if r < 0.6 * s.rounds:
            fit.split(s.most)
        fit.round(train, r / s.rounds, (r + 1) / s.rounds)
    kept = s.end_to_end and _explains_better(before, begun(fit.poses, surfaces(fit.poses)), held)
    kept = kept and apart(fit.poses) <= MOST_APART * apart(grown.poses)
    if kept:
        fit.poses = _with_std(fit, [mesh.vertices for mesh in fit.meshes], grown.seen)
    elif s.end_to_end:
        fit.poses = grown.poses
        for r in range(s.rounds // 2, s.rounds):
            fit.round(train, r / s.rounds, (r + 1) / s.rounds)
    fit.split(0)
    return Optimised(
        fit.poses, fit.free_poses(grown.seen), fit.parameters.gaussians(s.blended), fit.shares(scene), kept
    )


class Fit:
    """A model and a motion in the course of their optimisation."""

    def __init__(
        self,
        windows: Windows,
        meshes: tuple[Mesh, Mesh],
        poses: JointedPoses,
        rasterise: Rasterise,
        settings: GaussianSettings,
        rng: np.random.Generator,
    ) -> None:
        """Begins with discs on the parts' `meshes`, in the frame of `poses`."""
        self.windows, self.meshes, self.poses = windows, meshes, poses
        self.rasterise, self.settings, self.rng = rasterise, settings, rng
        self.parameters = discs(meshes, windows.footprint, settings, rng)
        self.adam = Adam(self.parameters)
        self.screen, self.looks = np.zeros(len(self.parameters)), np.zeros(len(self.parameters))
        self.coarseness = 1
        """Pixels each way that the adjustment takes as one."""
        self.cell = float(np.sqrt(sum(mesh.areas().sum() for mesh in meshes) / settings.cells))
        """Metres: size of the cells of the surface whose colour and depth the adjustment eliminates."""
        self.scales = Scales(0.05, max(windows.noise, 0.5 * windows.footprint), 0.3)
        self.last_step: Array | float = 0.0
        self.said: dict[int, Terms] = {}

    def copy(self) -> Fit:
        """Another that goes its own way from here; of what frames said, a tenth of a gigabyte, it has nothing."""
        own = copy.copy(self)
        own.parameters, own.adam = copy.deepcopy(self.parameters), copy.deepcopy(self.adam)
        own.screen, own.looks = self.screen.copy(), self.looks.copy()
        own.said = {}
        own.rng = copy.deepcopy(self.rng)
        return own

    def round(self, train: Flags, begin: float, end: float) -> None:
        """One step of the Gaussians at every frame of `train`; `begin` and `end` are shares of all that are done."""
        frames = np.flatnonzero(train)
        times = max(1, -(-SHORTEST_ROUND // max(len(frames), 1)))
        order = np.concatenate([self.rng.permutation(frames) for _ in range(times)]) if len(frames) else frames
        for k, i in enumerate(order):
            _, self.said[int(i)] = self.step(int(i), begin + (end - begin) * k / len(order))

    def step(self, i: int, progress: float) -> tuple[Loss, Terms]:
        """One step of the Gaussians by frame i; `progress` is 0 at the beginning and 1 at the end."""
        s = self.settings
        gaussians, picture, pull, back = self.draw(i)
        target = self.windows[i].target()
        background = self.rng.random(3).astype(np.float32)
        value = loss(picture, target, background, self.windows.depth_unit, s)
        d = back(pull(value.d_colour, value.d_depth, value.d_alpha))
        o, w = gaussians.opacities, gaussians.part_weights
        gradient = {
            "means": d["means"],
            "quaternions": d["quaternions"],
            "log_scales": d["scales"] * gaussians.scales,
            "opacity_logits": d["opacities"] * o * (1 - o),
            "colours": d["colours"],
            "weight_logits": d["part_weights"] * w * (1 - w),
            "light": d["light"],
        }
        # the sum of its weights in the picture: hidden behind others it learns nothing, and is not there
        shown = np.abs(d["colours"]).sum(1) * value.d_alpha.size > SHOWN
        self.screen[shown] += d["screen"][shown] * value.d_alpha.size
        self.looks[shown] += 1
        left = s.last_rate**progress
        rates = {
            "means": s.rate_means * self.windows.footprint,
            "quaternions": s.rate_quaternions,
            "log_scales": s.rate_scales,
            "opacity_logits": s.rate_opacities,
            "colours": s.rate_colours,
            "weight_logits": s.rate_weights if s.blended else 0.0,
            "light": s.rate_light,
        }
        self.adam.step(self.parameters, gradient, shown, {name: rate * left for name, rate in rates.items()})
        return value, self._terms(i, picture)

    def draw(self, i: int) -> tuple[Gaussians, Picture, Pull, Back]:
        """The model in frame i."""
        gaussians = self.parameters.gaussians(self.settings.blended)
        Ts = self.part_poses(i)
        splats, back = splats_of(gaussians, Ts)
        return gaussians, *self.rasterise(splats, Ts, self.windows[i].lens), back

    def part_poses(self, i: int) -> Array:
        """(2, 4, 4) camera from canonical of both parts in frame i."""
        T = self.poses.Ts[i]
        return np.stack([T, T @ self.poses.joint.transform(float(self.poses.states[i]))])

    def look(self, i: int) -> Terms:
        """What frame i says of its poses."""
        return self._terms(i, self.draw(i)[1])

    def _terms(self, i: int, picture: Picture) -> Terms:
        window = self.windows[i]
        return alignment_terms(
            picture, window.target(), window.lens, self.part_poses(i), self.scales, self.cell, self.coarseness
        )

    def adjust(self, train: Flags, held: Flags, momentum: float) -> None:
        """A step of all poses and states, and of the joint, by what the frames of `train` said in the last round.

        Frames that are held back go with the joint and have no say in it.
        """
        self.said |= {int(i): self.look(int(i)).before_a_fixed_model() for i in np.flatnonzero(held)}
        self.rescale()
        n = len(self.poses.Ts)
        all_frames: Reduced = reduced(self.said, n)
        A, b = all_frames.A, all_frames.b
        M, across = joint_jacobian(self.poses)
        J = M.toarray()
        J[~np.repeat(train, 6), 7 * n :] = 0
        A_all, b_all = J.T @ A[1] @ J, J.T @ b[1]
        A_all[: 6 * n, : 6 * n] += A[0]
        b_all[: 6 * n] += b[0]
        smooth, b_all = with_state_smoothness(sparse.csr_array(A_all), b_all, np.zeros(n))
        step = _solved(smooth.toarray(), b_all)
        self.last_step = step + momentum * self.last_step
        self.poses = stepped(self.poses, self.last_step, across, self.windows.diagonal)
        self._shift_surface(all_frames, (step[: 6 * n], J @ step))

    def _shift_surface(self, found: Reduced, twists: tuple[Array, Array]) -> None:
        """Let the surface go with the motion: every Gaussian with its patch."""
        shift = found.shifts(twists)
        length = np.linalg.norm(shift, axis=1, keepdims=True)
        shift *= np.minimum(1, FARTHEST * self.windows.footprint / np.maximum(length, 1e-12))
        p = self.parameters
        p.means += shift[cells_of(p.means, p.weight_logits < 0, self.cell)].astype(np.float32)

    def localise(self, frames: Flags) -> Array:
        """Mean costs of residuals in each of `frames`, brought to the model by itself, the joint as it is."""
        n = len(self.poses.Ts)
        for k in range(TRIAL_STEPS + 1):
            terms = {int(i): self.look(int(i)) for i in np.flatnonzero(frames)}
            if k == TRIAL_STEPS:
                break
            M, across = joint_jacobian(self.poses)
            J = M.toarray()
            H, g = np.zeros((2, n, 6, 6)), np.zeros((2, n, 6))
            for i, t in terms.items():
                H[:, i], g[:, i] = t.H, t.g
            step = np.zeros(J.shape[1])
            for i in terms:
                own = np.append(6 * i + np.arange(6), 6 * n + i)
                Ji = J[6 * i : 6 * i + 6, own]
                A = Ji.T @ H[1, i] @ Ji
                A[:6, :6] += H[0, i]
                b = Ji.T @ g[1, i]
                b[:6] += g[0, i]
                step[own] = _solved(A, b)
            self.poses = stepped(self.poses, step, across, self.windows.diagonal)
        return np.array([t.cost / max(t.count, 1.0) for t in terms.values()])

    def free_poses(self, seen: Flags) -> tuple[FreePoses, FreePoses]:
        """Poses of both parts, each by itself before the model, where `seen` (n, 2); elsewhere those of the joint."""
        n = len(seen)
        Ts = [self.poses.Ts.copy(), self.poses.Ts_moving.copy()]
        covariances = np.full((2, n, 6, 6), np.nan)
        gaussians = self.parameters.gaussians(self.settings.blended)
        coarseness = FREE_COARSE
        pixels = (self.cell / self.windows.footprint) ** 2
        for i in np.flatnonzero(self.windows.shown & seen.any(1)):
            window = self.windows[int(i)]
            for k in range(FREE_STEPS + 1):
                both = np.stack([Ts[0][i], Ts[1][i]])
                picture, _ = self.rasterise(splats_of(gaussians, both)[0], both, window.lens)
                t = alignment_terms(picture, window.target(), window.lens, both, self.scales, self.cell, coarseness)
                for part in np.flatnonzero(seen[i]):
                    H = t.H[part] + np.diag(1e-3 * np.diag(t.H[part]) + 1e-9 * max(float(t.H[part].max()), 1e-30))
                    if k < FREE_STEPS:
                        Ts[part][i] = se3.exp_se3(limited(np.linalg.solve(H, -t.g[part])[None])[0]) @ Ts[part][i]
                    else:
                        covariances[part, i] = pixels * np.linalg.inv(H)
        return FreePoses(Ts[0], covariances[0]), FreePoses(Ts[1], covariances[1])

    def rescale(self) -> None:
        """Scales of residuals, anew from what they were."""
        spread = 1.4826 * np.nanmedian([t.spread for t in self.said.values()], 0)
        now = (self.scales.colour, self.scales.depth, self.scales.mask)
        found = [float(max(s, 1e-9)) if np.isfinite(s) else old for s, old in zip(spread, now, strict=True)]
        self.scales = Scales(*found)

    def split(self, most: int) -> None:
        """More Gaussians, up to `most`, where pictures asked for them since the last call; none that none showed."""
        pull = self.screen / np.maximum(self.looks, 1)
        self.parameters, which, fresh = grown_and_pruned(self.parameters, pull, self.looks, most)
        self.adam.kept(which, fresh)
        self.screen, self.looks = np.zeros(len(which)), np.zeros(len(which))

    def shares(self, scene: Scene) -> NDArray[np.float32]:
        """See `Optimised.shares`."""
        found = np.full(scene.mask.shape, np.nan, np.float32)
        for i in np.flatnonzero(self.windows.shown):
            picture = self.draw(int(i))[1]
            share = np.where(picture.alpha > COVERED, picture.moving / np.maximum(picture.alpha, COVERED), np.nan)
            found[i] = self.windows.in_crop(int(i), share.astype(np.float32), scene)
        return found


def _solved(A: Array, b: Array) -> Array:
    """The damped step -A^-1 b of a dense symmetric A."""
    diagonal = np.diag(A).copy()
    A[np.diag_indices_from(A)] += DAMPING * diagonal + 1e-9 * max(float(diagonal.max()), 1e-300)
    return np.asarray(solve(A, -b, assume_a="pos", overwrite_a=True, check_finite=False), float)


def _held_back(shown: Flags, every: int) -> Flags:
    """(n,) every so many of the frames `shown` (n,)."""
    held = np.zeros(len(shown), bool)
    held[np.flatnonzero(shown)[every // 2 :: every]] = True
    return held


def _explains_better(before: Fit, after: Fit, held: Flags) -> bool:
    """Whether the frames held back are explained better by the second of two models, each learned as the other was.

    Both are judged by the scales of the first, frame by frame; what is within chance (`SURELY` standard errors) does
    not count: where the old motion is good to a hundredth of a degree, as with a clean sensor, it stays.
    """
    after.scales = before.scales
    gain = before.localise(held) - after.localise(held)
    if len(gain) < 2:
        return False
    return bool(gain.mean() > SURELY * gain.std(ddof=1) / np.sqrt(len(gain)))


def _with_std(fit: Fit, clouds: list[Array], seen: Flags) -> JointedPoses:
    """The poses with the standard deviations of states, axis and pivot; `clouds` are points of the parts."""
    fit.said |= {int(i): fit.look(int(i)) for i in np.flatnonzero(fit.windows.shown)}
    n = len(seen)
    A = reduced(fit.said, n).A
    M, _ = joint_jacobian(fit.poses)
    J = M.toarray()
    A_all = J.T @ A[1] @ J
    A_all[: 6 * n, : 6 * n] += A[0]
    return with_std(fit.poses, A_all, seen, clouds, (fit.cell / fit.windows.footprint) ** 2, fit.windows.footprint)
