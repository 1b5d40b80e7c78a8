"""End-to-end optimisation (paper, End-to-end Optimization): Adam for the Gaussians, Gauss-Newton for the motion.

A round uses every frame once. The Gaussians take a step at every frame; poses, states, axis and pivot take one together
after the round, from the terms of all frames. The first rounds see images of half the resolution. Some frames are held
out of the training; only if these explain them better with the refined motion than with the one before, it is used, and
refined further by a model of full resolution.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import solve
from scipy.spatial import cKDTree

from freeart21 import se3
from freeart21.gaussians import Gaussians
from freeart21.mesh import Mesh
from freeart21.recording import Recording
from freeart21.se3 import Array
from reconstruct.gaussians.adam import Adam
from reconstruct.gaussians.alignment import (
    ReducedEquations,
    Scales,
    Terms,
    alignment_terms,
    eliminate_patches,
    patch_numbers,
)
from reconstruct.gaussians.backends import choose_backend
from reconstruct.gaussians.density import densify_and_prune
from reconstruct.gaussians.initial import place_discs
from reconstruct.gaussians.losses import COVERED, Loss, loss
from reconstruct.gaussians.model import SplatBackward, make_splats
from reconstruct.gaussians.rasteriser import Backward, Picture, Rasterise
from reconstruct.gaussians.windows import Windows, make_windows
from reconstruct.labels import SURE
from reconstruct.poses import (
    FreePoses,
    JointedPoses,
    add_standard_deviations,
    add_state_smoothness,
    apply_joint_step,
    joint_jacobian,
    limit_rotations,
)
from reconstruct.propagation import PartEstimate
from reconstruct.scene import Scene
from reconstruct.settings import GaussianSettings, ReconstructSettings
from reconstruct.surfaces import fuse

Flags = NDArray[np.bool_]

SHORTEST_ROUND = 100
"""Training steps of a round, at least: short videos are repeated, so that the model keeps up with the motion."""
DAMPING = 1e-6
"""Of the Gauss-Newton steps: a drift along the video has eigenvalues of 1e-4 of the diagonal."""
FINE = 1 / 3
"""Share of the rounds at full resolution; the others have half of it, a quarter of the pixels and Gaussians."""
FEWEST_PIXELS = 4000
"""Mean pixels of the foreground below which all rounds are at full resolution: a small part would have too few. With
2,000 and 8 rounds, a test clip's axis went from 1.0 to 1.2 degrees at half resolution, to 0.4 at full."""
COARSE = ((0.6, 4), (1.0, 2))
"""Pixel block edges up to shares of the first rounds. At full resolution the first step goes 16 % of the way, with
blocks of 4 pixels 40 % (noise2 swivel_usb)."""
FREE_STEPS, FREE_COARSE = 2, 2
"""Gauss-Newton steps of a part's pose without the joint, and their pixel block edge."""
FARTHEST = 20
"""Largest shift of a patch per step, footprints."""
MAX_DISAGREEMENT = 1.5
"""Largest ratio, after to before the refinement, of the depth images' squared disagreement. For the true motion it is
1.03 to 1.12 in seven recordings of a clean and a noisy sensor, and more for a sensor with systematic errors (2.7 and
4.8, time of flight). Refined motions that were two to six times as good had 1.07 to 1.26. The clean torch_lighter's had
1.7 to 1.9: its states were right to 0.03 degrees and drifted by 0.15 along the video, while held-out images were
explained better."""
SURELY = 2.0
"""Standard errors by which the held-out frames must be explained better."""
FEWEST_HELD_OUT, MOST_HELD_OUT = 10, 5
"""Held-out frames of a short video, at most every fifth: of five, a mean's error is itself uncertain by a third. A
right refinement of a noise2 stapler of 48 frames was refused by five (axis 0.92 degrees, 0.22 by ten)."""
FACING = 4.0
"""Pixels of distance that weigh as much as a difference of one between unit normals."""
SHOWN = 0.02
"""Visible area, pixels, from which an image shows a Gaussian."""
MOMENTUM = 0.5
"""Share of the last step of poses and joint that is repeated (half of it in the last third of the rounds): model and
motion wait for each other."""
PATCHES = 8000
"""Patches of the surface, which the pose adjustment may shift."""
RATES = {
    "means": 0.05,
    "quaternions": 1e-3,
    "log_scales": 5e-3,
    "opacity_logits": 5e-2,
    "colours": 5e-3,
    "weight_logits": 5e-2,
    "light": 5e-3,
}
"""Adam's learning rates, those of 3D Gaussian splatting for a tenth of its iterations; means in footprints."""
LAST_RATE = 0.1
"""Factor on the rates at the end."""
TRIAL_STEPS = 3
"""Gauss-Newton steps that align a held-out frame with a model before it is judged."""


@dataclass(frozen=True)
class OptimisedModel:
    """Result of the stage."""

    poses: JointedPoses
    free: tuple[FreePoses, FreePoses]
    """Both parts' poses, aligned with the model without the joint."""
    gaussians: Gaussians
    """In the frame of `poses`, joint state zero."""
    shares: NDArray[np.float32]
    """(n, h, w) of the scene's crops: the moving part's share of what the model shows, 0 to 1; NaN where it shows
    nothing."""
    motion_refined: bool
    """Whether `poses` are the refined ones."""

    def apply_to(self, estimate: PartEstimate) -> PartEstimate:
        """`estimate` with the refined motion and the model's part masks; unchanged when the motion was not refined.

        From labels of the time-of-flight swivel_usb with mIoU 0.807, the model converged to 0.945.
        """
        if not self.motion_refined:
            return estimate
        read = np.isfinite(self.shares) & (estimate.labels > 0)
        labels = np.where(read, np.where(self.shares > 0.5, 2, 1), estimate.labels).astype(np.uint8)
        logodds = np.where(read, 2 * SURE * (self.shares - 0.5), estimate.logodds).astype(np.float32)
        return replace(estimate, labels=labels, logodds=logodds, poses=replace(self.poses, cost=estimate.poses.cost))


def optimise(
    recording: Recording,
    scene: Scene,
    estimate: PartEstimate,
    settings: ReconstructSettings,
    rng: np.random.Generator,
    progress: Callable[[float], object] = lambda share: None,
    depth_disagreement: Callable[[JointedPoses], float] = lambda poses: 0.0,
) -> OptimisedModel | None:
    """The articulated model of a video, and its motion refined; None where no part has a surface to start from.

    `progress` is called with the finished share. `depth_disagreement` gives the squared disagreement of the video's
    depth images under a motion, independent of the model.
    """
    s = settings.gaussians
    windows = make_windows(recording, scene, s.most_pixels)
    pixels = np.mean([window.mask.sum() for window in windows.frames if window is not None] or [0])
    reduction = 2 if pixels >= FEWEST_PIXELS else 1
    reduced = windows.reduced(reduction)
    rasterise = choose_backend(s.backend)
    held_out = _choose_held_out(windows.nonempty, s.held_back)
    train = windows.nonempty & ~held_out
    seed = int(rng.integers(2**32))

    def surfaces(poses: JointedPoses) -> tuple[Mesh, Mesh]:
        Ts = (poses.Ts, poses.Ts_moving)
        first, second = (
            fuse(scene, estimate.labels, k + 1, Ts[k], estimate.seen[:, k], settings.surfaces) for k in range(2)
        )
        return first, second

    def warm_up_model(poses: JointedPoses, meshes: tuple[Mesh, Mesh]) -> Fit:
        """A model of the reduced images trained with a fixed motion for the warm-up rounds."""
        fit = Fit(reduced, meshes, poses, rasterise, s, np.random.default_rng(seed))
        fit.coarseness = COARSE[0][1] // reduction
        for r in range(s.warm_up):
            fit.train_round(train, r / s.rounds, (r + 1) / s.rounds, s.end_to_end)
        return fit

    meshes = surfaces(estimate.poses)
    if all(mesh.empty for mesh in meshes):
        return None
    coarse = warm_up_model(estimate.poses, meshes)
    before = coarse.copy()
    fine_rounds = max(1, round(FINE * s.rounds))
    first_fine = s.rounds - fine_rounds
    for r in range(s.warm_up, first_fine):
        progress(r / s.rounds)
        coarse.coarseness = next(c for until, c in COARSE if r < until * first_fine) // reduction
        if s.end_to_end:
            coarse.adjust_poses(train, held_out, MOMENTUM)
        coarse.densify(s.most)
        coarse.train_round(train, r / first_fine, (r + 1) / first_fine, s.end_to_end)

    def start_fine(poses: JointedPoses, meshes: tuple[Mesh, Mesh]) -> Fit:
        """A model of full resolution, not trained yet."""
        fit = Fit(windows, meshes, poses, rasterise, s, np.random.default_rng(seed))
        fit.start_from(coarse)
        return fit

    def train_fine(fit: Fit, refine: bool, first: int = 0) -> None:
        """Train a model of full resolution from round `first` on, and with `refine` its motion."""
        for r in range(first, fine_rounds):
            progress((first_fine + r) / s.rounds)
            if r > 0 and refine:
                fit.adjust_poses(train, held_out, MOMENTUM / 2)
            if 0 < r < fine_rounds - 1:
                fit.densify(s.most)
            fit.train_round(train, r / fine_rounds, (r + 1) / fine_rounds, refine)

    fit, refined = None, False
    if s.end_to_end:
        new_meshes = surfaces(coarse.poses)
        if _explains_better(before, warm_up_model(coarse.poses, new_meshes), held_out):
            fit = start_fine(coarse.poses, new_meshes)
            train_fine(fit, refine=True)
            refined = depth_disagreement(fit.poses) <= MAX_DISAGREEMENT * depth_disagreement(estimate.poses)
    if fit is None:
        fit = start_fine(estimate.poses, meshes)
        train_fine(fit, refine=False)
    elif refined:
        fit.poses = _with_std(fit, [mesh.vertices for mesh in fit.meshes], estimate.seen)
    else:
        fit.poses = estimate.poses
        train_fine(fit, refine=False, first=fine_rounds // 2)
    fit.densify(0)
    gaussians, shares = fit.parameters.gaussians(s.blended), fit.moving_shares(scene)
    return OptimisedModel(fit.poses, fit.refine_free_poses(estimate.seen), gaussians, shares, refined)


class Fit:
    """A model and a motion during their optimisation."""

    def __init__(
        self,
        windows: Windows,
        meshes: tuple[Mesh, Mesh],
        poses: JointedPoses,
        rasterise: Rasterise,
        settings: GaussianSettings,
        rng: np.random.Generator,
    ) -> None:
        """Starts with discs on the parts' `meshes`, in the frame of `poses`."""
        self.windows, self.meshes, self.poses = windows, meshes, poses
        self.rasterise, self.settings, self.rng = rasterise, settings, rng
        self.parameters = place_discs(meshes, windows.footprint, settings, rng)
        self.adam = Adam(self.parameters)
        self.screen_sums, self.views = np.zeros(len(self.parameters)), np.zeros(len(self.parameters))
        self.coarseness = 1
        """Edge of the pixel blocks that the pose adjustment uses."""
        self.cell = float(np.sqrt(sum(mesh.areas().sum() for mesh in meshes) / PATCHES))
        """Edge of the surface's patches, metres."""
        self.scales = Scales(0.05, max(windows.noise, 0.5 * windows.footprint), 0.3)
        self.last_step: Array | float = 0.0
        self.terms: dict[int, Terms] = {}

    def copy(self) -> Fit:
        """An independent copy, without the alignment terms (0.1 GB)."""
        own = copy.copy(self)
        own.parameters, own.adam = copy.deepcopy(self.parameters), copy.deepcopy(self.adam)
        own.screen_sums, own.views = self.screen_sums.copy(), self.views.copy()
        own.terms = {}
        own.rng = copy.deepcopy(self.rng)
        return own

    def train_round(self, train: Flags, begin: float, end: float, align: bool) -> None:
        """One step of the Gaussians at every frame of `train`, or several of a short video's; `begin` and `end` are
        shares of the whole training. `align` takes the alignment terms of the last step at each."""
        frames = np.flatnonzero(train)
        times = max(1, -(-SHORTEST_ROUND // max(len(frames), 1)))
        order = np.concatenate([self.rng.permutation(frames) for _ in range(times)]) if len(frames) else frames
        for k, i in enumerate(order):
            _, picture = self.train_step(int(i), begin + (end - begin) * k / len(order))
            if align and k >= len(order) - len(frames):
                self.terms[int(i)] = self._alignment_terms(int(i), picture)

    def start_from(self, coarse: Fit) -> None:
        """Take over a coarser model's light, and the part weights of its nearest Gaussians with a similar normal."""
        own, other = self.parameters, coarse.parameters
        own.light[:] = other.light
        if not len(other) or not self.settings.blended:
            return
        unit = FACING * coarse.windows.footprint
        places, others = (np.hstack([g.means, unit * g.normals]) for g in (own.gaussians(), other.gaussians()))
        own.weight_logits[:] = other.weight_logits[cKDTree(others).query(places)[1]]

    def train_step(self, i: int, progress: float) -> tuple[Loss, Picture]:
        """One step of the Gaussians at frame i; `progress` is 0 at the start of the training and 1 at its end."""
        s = self.settings
        gaussians, picture, pull, backward = self.render(i)
        target = self.windows[i].target()
        background = self.rng.random(3).astype(np.float32)
        value = loss(picture, target, background, self.windows.depth_unit, s)
        d = backward(pull(value.d_colour, value.d_depth, value.d_alpha))
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
        # by the sum of its blending weights: hidden Gaussians get no gradient
        shown = np.abs(d["colours"]).sum(1) * value.d_alpha.size > SHOWN
        self.screen_sums[shown] += d["screen"][shown] * value.d_alpha.size
        self.views[shown] += 1
        decay = LAST_RATE**progress
        rates = RATES | {"means": RATES["means"] * self.windows.footprint}
        if not s.blended:
            rates["weight_logits"] = 0.0
        self.adam.step(self.parameters, gradient, shown, {name: rate * decay for name, rate in rates.items()})
        return value, picture

    def render(self, i: int) -> tuple[Gaussians, Picture, Backward, SplatBackward]:
        """The model in frame i."""
        gaussians = self.parameters.gaussians(self.settings.blended)
        Ts = self.part_poses(i)
        splats, backward = make_splats(gaussians, Ts)
        return gaussians, *self.rasterise(splats, Ts, self.windows[i].lens), backward

    def part_poses(self, i: int) -> Array:
        """(2, 4, 4) camera from canonical of both parts in frame i."""
        T = self.poses.Ts[i]
        return np.stack([T, T @ self.poses.joint.transform(float(self.poses.states[i]))])

    def frame_terms(self, i: int) -> Terms:
        """The alignment terms of frame i."""
        return self._alignment_terms(i, self.render(i)[1])

    def _alignment_terms(self, i: int, picture: Picture) -> Terms:
        window = self.windows[i]
        return alignment_terms(
            picture, window.target(), window.lens, self.part_poses(i), self.scales, self.cell, self.coarseness
        )

    def adjust_poses(self, train: Flags, held_out: Flags, momentum: float) -> None:
        """One Gauss-Newton step of all poses, states and the joint, with the terms of the last round.

        Held-out frames follow the joint without influencing it.
        """
        self.terms |= {int(i): self.frame_terms(int(i)).before_a_fixed_model() for i in np.flatnonzero(held_out)}
        self.update_scales()
        n = len(self.poses.Ts)
        equations = eliminate_patches(self.terms, n)
        A, b = equations.A, equations.b
        M, across = joint_jacobian(self.poses)
        J = M.toarray()
        J[~np.repeat(train, 6), 7 * n :] = 0
        A_all, b_all = J.T @ A[1] @ J, J.T @ b[1]
        A_all[: 6 * n, : 6 * n] += A[0]
        b_all[: 6 * n] += b[0]
        smooth, b_all = add_state_smoothness(sparse.csr_array(A_all), b_all, np.zeros(n))
        step = self._hold_mean_distance(_solved(smooth.toarray(), b_all), train)
        self.last_step = step + momentum * self.last_step
        self.poses = apply_joint_step(self.poses, self.last_step, across, self.windows.diagonal)
        self._shift_surface(equations, (step[: 6 * n], J @ step))

    def _hold_mean_distance(self, step: Array, train: Flags) -> Array:
        """`step` without its mean shift of the object along the view, over the frames `train`.

        All frames a little nearer and the whole surface a little smaller leave the depths as they are. Then outlines
        alone decide, and those of discs are some tenths of a pixel too wide: the clean flip_cap_usb came 0.27 mm nearer
        (0.4 % of its size) and its surface shrank by as much. The geometry before knows the mean distance.
        """
        n = len(self.poses.Ts)
        twists = step[: 6 * n].reshape(n, 6)
        centre = self.parameters.means.mean(0, dtype=float)
        at = self.poses.Ts[:, :3, :3] @ centre + self.poses.Ts[:, :3, 3]
        nearer = twists[:, 2] + twists[:, 3] * at[:, 1] - twists[:, 4] * at[:, 0]
        held = step.copy()
        held[2 : 6 * n : 6] -= nearer[train].mean()
        return held

    def _shift_surface(self, found: ReducedEquations, twists: tuple[Array, Array]) -> None:
        """Shift every Gaussian with its patch."""
        shift = found.shifts(twists)
        length = np.linalg.norm(shift, axis=1, keepdims=True)
        shift *= np.minimum(1, FARTHEST * self.windows.footprint / np.maximum(length, 1e-12))
        p = self.parameters
        p.means += shift[patch_numbers(p.means, p.weight_logits < 0, self.cell)].astype(np.float32)

    def localise_frames(self, frames: Flags) -> Array:
        """Mean cost of the residuals of each of `frames`, each aligned with the model under the fixed joint."""
        n = len(self.poses.Ts)
        for k in range(TRIAL_STEPS + 1):
            terms = {int(i): self.frame_terms(int(i)) for i in np.flatnonzero(frames)}
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
            self.poses = apply_joint_step(self.poses, step, across, self.windows.diagonal)
        return np.array([t.cost / max(t.count, 1.0) for t in terms.values()])

    def refine_free_poses(self, seen: Flags) -> tuple[FreePoses, FreePoses]:
        """Poses of both parts, each aligned with the model by itself where `seen` (n, 2); elsewhere those under the
        joint."""
        n = len(seen)
        Ts = [self.poses.Ts.copy(), self.poses.Ts_moving.copy()]
        covariances = np.full((2, n, 6, 6), np.nan)
        gaussians = self.parameters.gaussians(self.settings.blended)
        coarseness = FREE_COARSE
        pixels = (self.cell / self.windows.footprint) ** 2
        for i in np.flatnonzero(self.windows.nonempty & seen.any(1)):
            window = self.windows[int(i)]
            for k in range(FREE_STEPS + 1):
                both = np.stack([Ts[0][i], Ts[1][i]])
                picture, _ = self.rasterise(make_splats(gaussians, both)[0], both, window.lens)
                t = alignment_terms(picture, window.target(), window.lens, both, self.scales, self.cell, coarseness)
                for part in np.flatnonzero(seen[i]):
                    H = t.H[part] + np.diag(1e-3 * np.diag(t.H[part]) + 1e-9 * max(float(t.H[part].max()), 1e-30))
                    if k < FREE_STEPS:
                        Ts[part][i] = (
                            se3.exp_se3(limit_rotations(np.linalg.solve(H, -t.g[part])[None])[0]) @ Ts[part][i]
                        )
                    else:
                        covariances[part, i] = pixels * np.linalg.inv(H)
        return FreePoses(Ts[0], covariances[0]), FreePoses(Ts[1], covariances[1])

    def update_scales(self) -> None:
        """Scales of residuals from their medians."""
        spread = 1.4826 * np.nanmedian([t.spread for t in self.terms.values()], 0)
        now = (self.scales.colour, self.scales.depth, self.scales.mask)
        found = [float(max(s, 1e-9)) if np.isfinite(s) else old for s, old in zip(spread, now, strict=True)]
        self.scales = Scales(*found)

    def densify(self, most: int) -> None:
        """Split Gaussians, up to `most` in all, by the gradients since the last call; remove those that no image
        showed."""
        pull = self.screen_sums / np.maximum(self.views, 1)
        self.parameters, which, fresh = densify_and_prune(self.parameters, pull, self.views, most)
        self.adam.select(which, fresh)
        self.screen_sums, self.views = np.zeros(len(which)), np.zeros(len(which))

    def moving_shares(self, scene: Scene) -> NDArray[np.float32]:
        """See `OptimisedModel.shares`."""
        found = np.full(scene.mask.shape, np.nan, np.float32)
        for i in np.flatnonzero(self.windows.nonempty):
            picture = self.render(int(i))[1]
            share = np.where(picture.alpha > COVERED, picture.moving / np.maximum(picture.alpha, COVERED), np.nan)
            found[i] = self.windows.in_crop(int(i), share.astype(np.float32), scene)
        return found


def _solved(A: Array, b: Array) -> Array:
    """The damped step -A^-1 b of a dense symmetric A."""
    diagonal = np.diag(A).copy()
    A[np.diag_indices_from(A)] += DAMPING * diagonal + 1e-9 * max(float(diagonal.max()), 1e-300)
    return np.asarray(solve(A, -b, assume_a="pos", overwrite_a=True, check_finite=False), float)


def _choose_held_out(shown: Flags, every: int) -> Flags:
    """(n,) every n-th (`every`) of the frames `shown` (n,)."""
    held_out, frames = np.zeros(len(shown), bool), np.flatnonzero(shown)
    every = max(MOST_HELD_OUT, min(every, len(frames) // FEWEST_HELD_OUT))
    held_out[frames[every // 2 :: every]] = True
    return held_out


def _explains_better(before: Fit, after: Fit, held_out: Flags) -> bool:
    """Whether the held-out frames are explained significantly better by the second of two equally trained models.

    Both are judged by the scales of the first, frame by frame. Where the old motion is right to a hundredth of a
    degree, as with a clean sensor, it stays.
    """
    after.scales = before.scales
    gain = before.localise_frames(held_out) - after.localise_frames(held_out)
    if len(gain) < 2:
        return False
    return bool(gain.mean() > SURELY * gain.std(ddof=1) / np.sqrt(len(gain)))


def _with_std(fit: Fit, clouds: list[Array], seen: Flags) -> JointedPoses:
    """The poses with standard deviations of states, axis and pivot; `clouds` are points of the parts."""
    fit.terms |= {int(i): fit.frame_terms(int(i)) for i in np.flatnonzero(fit.windows.nonempty)}
    n = len(seen)
    A = eliminate_patches(fit.terms, n).A
    M, _ = joint_jacobian(fit.poses)
    J = M.toarray()
    A_all = J.T @ A[1] @ J
    A_all[: 6 * n, : 6 * n] += A[0]
    return add_standard_deviations(
        fit.poses, A_all, seen, clouds, (fit.cell / fit.windows.footprint) ** 2, fit.windows.footprint
    )
