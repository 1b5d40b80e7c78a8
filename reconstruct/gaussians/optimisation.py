"""The optimisation itself (paper, End-to-end Optimization): Adam over the Gaussians, Gauss-Newton over the motion."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from freeart21.recording import Recording
from freeart21.se3 import Array
from reconstruct.gaussians.adam import Adam
from reconstruct.gaussians.alignment import Scales, Terms, alignment_terms, reduced
from reconstruct.gaussians.losses import Loss, Target, loss
from reconstruct.gaussians.model import Parameters, splats_of
from reconstruct.gaussians.rasteriser import Lens, Rasterise
from reconstruct.kernels import each_in_threads
from reconstruct.poses import (
    JointedPoses,
    _damped_solve,
    _from_blocks,
    _joint_jacobian,
    _stepped,
    _with_state_smoothness,
)
from reconstruct.scene import Scene
from reconstruct.settings import GaussianSettings

MARGIN = 8
"""Pixels of a frame's window round its mask."""
JUMP = 4.0
"""Footprints between neighbours' depths beyond which neither is believed: sensors mix what they see there."""


@dataclass(frozen=True)
class Window:
    """What a frame shows of the object, and through which lens."""

    lens: Lens
    rgb: NDArray[np.uint8]
    depth: Floats
    """(h, w) metres; minus the depth of what is not the object; 0 where there is none or it is not believed."""
    mask: NDArray[np.bool_]

    def target(self) -> Target:
        """The same as numbers."""
        return Target(
            self.rgb.astype(np.float32) / 255,
            np.maximum(self.depth, 0),
            self.mask,
            np.maximum(-self.depth, 0),
        )


@dataclass(frozen=True)
class Video:
    """Windows of all frames at one resolution; None where a frame shows nothing."""

    windows: tuple[Window | None, ...]
    footprint: float
    """Metres a pixel covers at the object."""
    noise: float
    """Metres: standard deviation of the depth."""
    diagonal: float
    """Metres: the object's size."""

    @property
    def shown(self) -> NDArray[np.bool_]:
        """(n,) frames that show the object."""
        return np.array([window is not None for window in self.windows])


def crops(scene: Scene) -> Video:
    """The windows at the resolution that the solver works at."""
    windows = []
    for i, mask in enumerate(scene.mask):
        box = _box(mask)
        if box is None:
            windows.append(None)
            continue
        z = scene.points[i, ..., 2]
        depth = np.where(scene.edge[i] & (z > 0), 0, z).astype(np.float32)
        lens = (scene.fx, scene.fy, scene.cx[i] + 0.5, scene.cy[i] + 0.5)
        windows.append(_window(lens, scene.rgb[i], depth, mask, box))
    return Video(tuple(windows), scene.footprint, scene.noise, scene.diagonal)


def full_frames(recording: Recording, scene: Scene) -> Video:
    """The windows at the recording's own resolution."""
    K = recording.camera.K
    footprint = scene.footprint / scene.factor

    def load(i: int) -> Window | None:
        frame = recording.frame(i)
        box = _box(frame.mask)
        if box is None:
            return None
        inside = np.where(frame.mask, frame.depth, 0).astype(np.float32)
        far = np.where(inside > 0, inside, np.float32(np.inf))
        low = cv2.erode(far, np.ones((3, 3)))
        sound = (inside > 0) & (cv2.dilate(inside, np.ones((3, 3))) - low < JUMP * footprint + 4 * scene.noise)
        depth = np.where(frame.mask, np.where(sound, inside, 0), -frame.depth).astype(np.float32)
        return _window((K[0, 0], K[1, 1], K[0, 2], K[1, 2]), frame.rgb, depth, frame.mask, box)

    windows = each_in_threads(load, len(recording))
    return Video(tuple(windows), footprint, scene.noise, scene.diagonal)


def _box(mask: NDArray[np.bool_]) -> tuple[slice, slice] | None:
    ys, xs = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not len(xs):
        return None
    return (
        slice(max(0, int(ys[0]) - MARGIN), int(ys[-1]) + 1 + MARGIN),
        slice(max(0, int(xs[0]) - MARGIN), int(xs[-1]) + 1 + MARGIN),
    )


def _window(
    lens: tuple[float, float, float, float],
    rgb: NDArray[np.uint8],
    depth: Floats,
    mask: NDArray[np.bool_],
    box: tuple[slice, slice],
) -> Window:
    fx, fy, cx, cy = map(float, lens)
    h, w = mask[box].shape
    return Window(
        Lens(fx, fy, cx - box[1].start, cy - box[0].start, w, h), rgb[box].copy(), depth[box].copy(), mask[box].copy()
    )


class Fit:
    """An articulated model in the course of its optimisation."""

    def __init__(
        self,
        video: Video,
        parameters: Parameters,
        poses: JointedPoses,
        rasterise: Rasterise,
        settings: GaussianSettings,
        rng: np.random.Generator,
    ) -> None:
        self.video, self.parameters, self.poses = video, parameters, poses
        self.rasterise, self.settings, self.rng = rasterise, settings, rng
        self.adam = Adam(parameters)
        self.last_step: Array | float = 0.0
        self.screen = np.zeros(len(parameters))
        self.looks = np.zeros(len(parameters))
        self.scales = Scales(0.05, max(video.noise, 0.5 * video.footprint), 0.3)

    def draw(self, i: int, T_reference: Array | None = None, T_moving: Array | None = None):
        gaussians = self.parameters.gaussians(self.settings.blended)
        T = self.poses.Ts[i] if T_reference is None else T_reference
        M = T @ self.poses.joint.transform(float(self.poses.states[i])) if T_moving is None else T_moving
        Ts = np.stack([T, M])
        splats, back = splats_of(gaussians, Ts)
        picture, pull = self.rasterise(splats, Ts, self.video.windows[i].lens)
        return gaussians, picture, pull, back

    def step(self, i: int, progress: float) -> tuple[Loss, Terms]:
        """One step of the Gaussians by frame i; `progress` is 0 at the beginning and 1 at the end."""
        s, p = self.settings, self.parameters
        gaussians, picture, pull, back = self.draw(i)
        target = self.video.windows[i].target()
        background = self.rng.random(3).astype(np.float32)
        value = loss(picture, target, background, self.video.diagonal / 2, s)
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
        shown = d["drawn"] > 0
        self.screen[shown] += d["screen"][shown] * value.d_alpha.size
        self.looks[shown] += 1
        left = s.last_rate**progress
        rates = {
            "means": s.rate_means * self.video.footprint * left,
            "quaternions": s.rate_quaternions * left,
            "log_scales": s.rate_scales * left,
            "opacity_logits": s.rate_opacities * left,
            "colours": s.rate_colours * left,
            "weight_logits": s.rate_weights * left if s.blended else 0.0,
            "light": s.rate_light * left,
        }
        self.adam.step(p, gradient, shown, rates)
        return value, self.terms(i, picture, target)

    def terms(self, i: int, picture: Picture, target: Target) -> Terms:
        """What frame i says of its poses."""
        cell = self.settings.cell * self.video.footprint
        T = self.poses.Ts[i]
        Ts = np.stack([T, T @ self.poses.joint.transform(float(self.poses.states[i]))])
        return alignment_terms(picture, target, self.video.windows[i].lens, Ts, self.scales, cell)

    def look(self, i: int) -> Terms:
        """What frame i says of its poses, without a step."""
        _, picture, _, _ = self.draw(i)
        return self.terms(i, picture, self.video.windows[i].target())

    def move(self, terms: dict[int, Terms], sharing: NDArray[np.bool_], joint: bool = True) -> float:
        """One Gauss-Newton step of all poses and states, and of the joint by the frames `sharing` (n,)."""
        n = len(self.poses.Ts)
        A, b = reduced(terms, n)
        M, across = _joint_jacobian(self.poses)
        M = M.toarray()
        shared = M.shape[1] - 7 * n
        if joint:  # frames that are held back move by the joint, and have no say in it
            M[~np.repeat(sharing, 6), 7 * n :] = 0
        else:
            M = M[:, : 7 * n]
        A1 = M.T @ A[1] @ M
        A1[: 6 * n, : 6 * n] += A[0]
        b1 = M.T @ b[1]
        b1[: 6 * n] += b[0]
        A, b = sparse.csr_array(A1), b1
        before = self.poses
        step = _damped_solve(*_with_state_smoothness(A, b, np.zeros(n)))
        if not joint:
            step = np.concatenate([step, np.zeros(shared)])
        if joint:
            step = step + getattr(self, "beta", self.settings.momentum) * self.last_step
            self.last_step = step
        self.poses = _stepped(self.poses, step, across, self.video.diagonal)
        return float(np.abs(self.poses.states - before.states).mean())

    def rescale(self, terms: dict[int, Terms]) -> None:
        """Scales of residuals, anew from what they were."""
        spread = 1.4826 * np.nanmedian([t.spread for t in terms.values()], 0)
        now = self.scales
        self.scales = Scales(
            *(
                float(max(s, 1e-9)) if np.isfinite(s) else old
                for s, old in zip(spread, (now.colour, now.depth, now.mask), strict=True)
            )
        )
