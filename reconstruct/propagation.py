"""State of the propagation: poses, labels and joint of the frames done so far, and how a frame is registered."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.joint import Joint
from freeart21.se3 import Array
from reconstruct import rigid
from reconstruct.evidence import Evidence, PartReferences, Records, Samples, sample_pixels
from reconstruct.joint_type import choose_joint_type
from reconstruct.labels import SURE, is_ambiguous, label_frame
from reconstruct.poses import JointedPoses
from reconstruct.scene import UnsolvableError
from reconstruct.seeds import Seed
from reconstruct.settings import ReconstructSettings
from reconstruct.tracks import Tracker, bilinear

SAMPLES = 600
"""Pixels of a part in a reference frame that take part in registration."""
REFERENCES = 6
"""Reference frames per registration."""
MAX_TURN_DEG = 50.0
"""Largest view change to a reference frame."""
GATES = (18.0, 13.0, 9.0, 6.0, 5.0, 4.0)
"""Point-to-plane gates of the registration, coarse to fine."""
FINE_GATES = (6.0, 5.0, 4.0)
"""The same from a good initial guess."""
MIN_PART_PIXELS = 60
"""Fewer pixels of a part do not fix its pose when it moves freely."""
MIN_JOINTED_PIXELS = 12
"""Fewer pixels of a part do not fix its state when the joint is known."""
STATE_SURPRISE = 0.05
"""Standard deviation of the state's change of velocity per frame: radians, or object diagonals."""
REST_COST = 1.02
"""The joint is taken to rest in a frame whose cost at rest is at most this times that with motion."""
UNCERTAIN_SHARE = 0.1
"""A frame with a larger share of uncertain pixels is labelled again when the joint is adjusted."""
MAX_RELABELLED = 40
"""Frames that are labelled again each time, at most: the most uncertain ones."""
AGREEMENT = 5.0
"""Units of `Evidence.unit` within which two poses of a frame agree."""
AGREEING_FRAMES = 3
"""Consecutive frames that must agree."""


@dataclass(frozen=True)
class PartEstimate:
    """Labels, poses and joint of both parts in every frame."""

    poses: JointedPoses
    labels: NDArray[np.uint8]
    """(n, h, w): 0 neither, 1 first part, 2 second part."""
    logodds: NDArray[np.float32]
    """(n, h, w) > 0 for the second part."""
    seen: NDArray[np.bool_]
    """(n, 2) whether each part shows enough pixels."""


class Propagation:
    """Poses and labels of the frames done so far."""

    def __init__(
        self,
        evidence: Evidence,
        tracker: Tracker,
        seed: Seed,
        settings: ReconstructSettings,
        rng: np.random.Generator,
    ) -> None:
        scene = evidence.scene
        self.evidence, self.tracker, self.settings, self.rng = evidence, tracker, settings, rng
        n = len(scene)
        self.Ts = np.tile(np.eye(4), (2, n, 1, 1))
        """(2, n, 4, 4) camera from part."""
        self.states = np.zeros(n)
        self.joint: Joint | None = None
        self.logodds = np.zeros(scene.mask.shape, np.float32)
        self.labels = np.zeros(scene.mask.shape, np.uint8)
        self.done = np.zeros(n, bool)
        self.seen = np.zeros((n, 2), bool)
        """(n, 2) whether each part shows enough pixels."""
        self.ambiguous = np.zeros(n, bool)
        """(n,) frames in which either part may be among the uncertain pixels; see `labels.is_ambiguous`."""
        self.samples: tuple[Samples, Samples] = ({}, {})
        """Certain pixels of each part, by frame."""
        self.ambiguous_samples: Samples = {}
        """Uncertain pixels, by frame."""
        self._record_cache: dict[tuple[int, bytes, bytes], Records] = {}
        self.costs = np.full(n, np.nan)
        """(n,) cost of each frame under the joint."""
        self.recovered_frames: list[tuple[int, int]] = []
        """(frame, neighbour) pairs at which a lost part was found again."""
        self.set_labels(seed.frame, np.clip(seed.logodds, -SURE, SURE))
        self.done[seed.frame] = True
        self.body: Array | None = None
        """Result of `body_points`; None when it is out of date."""

    def references(self, k: int, T: Array, frame: int) -> NDArray[np.int64]:
        """Frames to register part `k` of `frame` at pose `T` against: the nearest in time, and those of the most
        similar view."""
        known = np.flatnonzero(self.done & (self.seen[:, k] | (self._same_state_frames(frame) if k == 0 else False)))
        known = known[known != frame]
        if len(known) == 0:
            return known
        turn = rigid.view_angle(self.Ts[k, known, :3, :3], T[:3, :3])
        chosen = [int(i) for i in known[np.argsort(np.abs(known - frame), kind="stable")[:2]]]
        for c in np.argsort(turn + 0.004 * np.minimum(np.abs(known - frame), 20), kind="stable"):
            if len(chosen) >= REFERENCES or turn[c] > np.radians(MAX_TURN_DEG):
                break
            if all(abs(known[c] - other) > 2 for other in chosen):
                chosen.append(int(known[c]))
        return np.array(sorted(set(chosen)), int)

    def _same_state_frames(self, frame: int) -> NDArray[np.bool_]:
        """(n,) frames with the joint state that `frame` has now: there both parts move as one. All false without a
        joint."""
        if self.joint is None:
            return np.zeros(len(self.done), bool)
        return self.done & (np.abs(self.states - self.states[frame]) < 0.05 * self.max_state_step())

    def _samples(self, k: int, references: NDArray[np.int64], frame: int) -> Samples:
        """Pixels of part k in `references`; for the first part with uncertain pixels of frames in which both move as
        one."""
        found = {int(r): self.samples[k][int(r)] for r in references}
        for r in references[self._same_state_frames(frame)[references]] if k == 0 else ():
            found[int(r)] = np.concatenate([found[int(r)], self.ambiguous_samples[int(r)]])
        return found

    def _records(self, k: int, references: NDArray[np.int64], frame: int) -> Records:
        """The records of `_samples`, cached until the samples change: a frame is registered from several initial
        guesses."""
        same_state = self._same_state_frames(frame)[references] if k == 0 else references[:0]
        key = k, references.tobytes(), same_state.tobytes()
        if key not in self._record_cache:
            self._record_cache[key] = self.evidence.records(self._samples(k, references, frame))
        return self._record_cache[key]

    def _part_references(self, k: int, references: NDArray[np.int64], frame: int) -> PartReferences:
        """What part k of `frame` is registered to."""
        Ts_part = se3.inverse(self.Ts[k, references])
        return PartReferences(references, Ts_part, self._records(k, references, frame))

    def register_part(
        self, k: int, frame: int, T: Array, references: NDArray[Any], gates: tuple[float, ...]
    ) -> tuple[Array, float]:
        """Part k's pose after Gauss-Newton through the gates, and inliers per reference."""
        known = self._part_references(k, references, frame)
        T, stats = self.evidence.register_pose(T, frame, known, gates, self.labels, k + 1)
        return T, stats[0] / len(references)

    def register_with_joint(
        self, frame: int, T: Array, q: float, gates: tuple[float, ...], at_rest: bool = False
    ) -> tuple[Array, float, float]:
        """Reference pose and state after Gauss-Newton with six plus one unknowns, and their cost. `at_rest` fixes the
        state."""
        assert self.joint is not None
        self.states[frame] = q
        poses = self.part_poses(T, q)
        first, second = (self._part_references(k, self.references(k, poses[k], frame), frame) for k in range(2))
        most = self.max_state_step()
        stray = STATE_SURPRISE * 10 * most
        prior = self.settings.growth.surprise_weight / stray**2, self._extrapolate_state(frame)
        start, known = (T, q, self.joint, frame), ((first, second), gates, self.labels)
        T, q = self.evidence.register_jointed_pose(*start, *known, prior, most, at_rest)
        return T, q, self.cost_with_joint(frame, T, q)

    def cost_with_joint(self, frame: int, T: Array, q: float) -> float:
        """Mean cost of the parts' samples in `frame`, plus that of the pixels of `frame` under the better motion."""
        poses = self.part_poses(T, q)
        references = [self.references(k, poses[k], frame) for k in range(2)]
        costs = [self._pixel_costs(k, frame, poses[k], references[k]) for k in range(2)]
        if not sum(map(len, costs)):
            return np.inf
        return float(np.concatenate(costs).mean()) + self._best_explained_cost(frame, poses, references)

    def _best_explained_cost(
        self, frame: int, poses: tuple[Array, Array], references: list[NDArray[np.int64]]
    ) -> float:
        """Mean cost of the pixels of `frame`, each under the motion that explains it better."""
        pixels = np.argwhere(self.evidence.scene.valid[frame])
        if len(pixels) == 0:
            return 0.0
        pixels = pixels[:: max(1, len(pixels) // SAMPLES)]
        costs = []
        for k, others in enumerate(references):
            if len(others):
                T = (self.Ts[k, others] @ se3.inverse(poses[k]))[:, None].repeat(2, 1)
                found = self.evidence.costs(frame, others, T, pixels, self.logodds, 0.5)
                costs.append(found[:, :, k].mean(1))
        return float(np.min(costs, axis=0).mean())

    def _pixel_costs(self, k: int, frame: int, T: Array, references: NDArray[np.int64]) -> Array:
        """Costs of a third of the references' samples with part k at `T` in `frame`."""
        parts = []
        for r, pixels in self._samples(k, references, frame).items():
            motion = (T @ se3.inverse(self.Ts[k, r]))[None, None]
            parts.append(self.evidence.costs(r, np.array([frame]), motion, pixels[::3])[:, 0, 0])
        return np.concatenate(parts) if parts else np.zeros(0)

    def cost(self, k: int, frame: int, T: Array, references: NDArray[np.int64]) -> float:
        """Mean cost of part k's samples with it at `T` in `frame`."""
        costs = self._pixel_costs(k, frame, T, references)
        return float(costs.mean()) if len(costs) else np.inf

    def predict_part_poses(self, k: int, frame: int, neighbour: int) -> list[Array]:
        """Initial guesses of part k's pose: constant, constant velocity, the other part's velocity, the tracks' motion,
        and given poses."""
        T, before = self.Ts[:, neighbour], 2 * neighbour - frame
        guesses = [T[k]]
        if 0 <= before < len(self.done) and self.done[before]:
            guesses += [T[m] @ se3.inverse(self.Ts[m, before]) @ T[k] for m in (k, 1 - k)]
        tracked = self._motion_from_tracks(k, frame, neighbour)
        return guesses + ([] if tracked is None else [tracked @ T[k]]) + self._given_poses(k, frame)

    def initial_guesses(self, frame: int, neighbour: int) -> list[tuple[Array, float]]:
        """Initial guesses of reference pose and state."""
        assert self.joint is not None
        T, q, before = self.Ts[0, neighbour], self.states[neighbour], 2 * neighbour - frame
        guesses = [(T, q)]
        ahead = q
        if 0 <= before < len(self.done) and self.done[before] and not self.is_state_jump(q - self.states[before]):
            ahead = 2 * q - self.states[before]
            velocity = T @ se3.inverse(self.Ts[0, before])
            guesses += [(velocity @ T, ahead), (velocity @ T, q)]
        for k in range(2):
            tracked = self._motion_from_tracks(k, frame, neighbour)
            poses = [] if tracked is None else [tracked @ self.Ts[k, neighbour]]
            for pose in poses + self._given_poses(k, frame):
                guesses.append((pose if k == 0 else pose @ se3.inverse(self.joint.transform(ahead)), ahead))
        return [(se3.orthonormalised(T), q) for T, q in guesses]

    def _motion_from_tracks(self, k: int, frame: int, neighbour: int) -> Array | None:
        """Motion (4, 4) of part k from `neighbour` to `frame` by its tracks; None when there are too few."""
        pixels = self.samples[k].get(neighbour)
        if pixels is None or len(pixels) < 40:
            return None
        direction = frame - neighbour
        tracks = self.tracker.follow(neighbour, 1, direction, pixels)
        kept = tracks.visible[:, -1]
        if kept.sum() < 25:
            return None
        return rigid.ransac_fit(tracks.points[kept, 0], tracks.points[kept, -1], 3 * self.evidence.unit, self.rng)

    def _given_poses(self, k: int, frame: int) -> list[Array]:
        """Poses of part k in `frame` if it moved as the bodies that another program tracked, from the nearest frame
        that shows it. Which body is which part is for the costs to decide."""
        poses = []
        for Ts in self.evidence.given_poses:
            tracked = np.isfinite(Ts[:, 0, 0])
            known = np.flatnonzero(self.done & self.seen[:, k] & tracked & (np.arange(len(Ts)) != frame))
            if tracked[frame] and len(known):
                near = known[np.abs(known - frame).argmin()]
                poses.append(Ts[frame] @ se3.inverse(Ts[near]) @ self.Ts[k, near])
        return poses

    def _extrapolate_state(self, frame: int) -> float:
        """The state of `frame` at constant velocity from the two nearest frames done."""
        known = np.flatnonzero(self.done)
        near = known[np.argsort(np.abs(known - frame), kind="stable")]
        a, b = near[0], near[min(1, len(near) - 1)]
        if abs(a - b) != 1 or self.is_state_jump(self.states[a] - self.states[b]):
            return float(self.states[a])
        return float(2 * self.states[a] - self.states[b])

    def part_poses(self, T: Array, q: float) -> tuple[Array, Array]:
        """Poses of both parts."""
        assert self.joint is not None
        return T, T @ self.joint.transform(q)

    def is_state_jump(self, step: float) -> bool:
        """Whether a change of the state between neighbouring frames is too fast for a hand."""
        assert self.joint is not None
        return bool(abs(step) > (0.2 if self.joint.type == "revolute" else 0.06 * self.evidence.scene.diagonal))

    def max_state_step(self) -> float:
        """Largest change of the state in one Gauss-Newton step, radians or metres."""
        assert self.joint is not None
        return 0.1 if self.joint.type == "revolute" else 0.1 * self.evidence.scene.diagonal

    def displacement(self, frame: int, T: Array, q: float) -> float:
        """Metres by which points round the second part move from the poses of `frame` to `T`, `q`, as either part's."""
        body = self.body_points() if self.body is None else self.body
        now = [se3.transform(T_k, body) for T_k in self.part_poses(T, q)]
        was = [se3.transform(T_k, body) for T_k in self.Ts[:, frame]]
        return float(np.linalg.norm(np.subtract(now, was), axis=2).max())

    def set_pose(self, frame: int, T: Array, q: float) -> None:
        """Set both parts' poses of a frame from reference pose and state."""
        assert self.joint is not None
        self.Ts[0, frame], self.states[frame] = T, q
        self.Ts[1, frame] = T @ self.joint.transform(q)

    def measured_frames(self) -> NDArray[np.bool_]:
        """(n,) frames done whose joint state was measured."""
        return self.done & (np.asarray(self.seen.all(1)) | self.ambiguous)

    def carry_labels(self, frame: int, neighbour: int) -> NDArray[np.uint8]:
        """Labels (h, w) that optical flow brings from a neighbour; 0 off the mask and where flow is inconsistent.

        They keep a vanishing part from being matched to the surface of the other.
        """
        direction = neighbour - frame
        mask = self.evidence.scene.mask[frame]
        h, w = mask.shape
        at = np.argwhere(mask)[:, ::-1].astype(float)
        there = at + self.tracker.step(frame, direction)[mask].astype(float)
        round_trip = np.linalg.norm(there + bilinear(self.tracker.step(neighbour, -direction), there) - at, axis=1)
        x = np.clip(np.rint(there[:, 0]).astype(int), 0, w - 1)
        y = np.clip(np.rint(there[:, 1]).astype(int), 0, h - 1)
        sure = (round_trip < self.settings.tracks.max_round_trip) & (np.abs(self.logodds[neighbour, y, x]) > 1)
        labels = np.zeros((h, w), np.uint8)
        labels[mask] = np.where(sure, self.labels[neighbour, y, x], 0)
        return labels

    def label_frame(self, frame: int) -> None:
        """Label `frame` from the costs of all its pixels under both motions to the frames done."""
        known = self.done & (self.seen.any(1) | self.ambiguous)
        self.body = self.body_points() if self.body is None else self.body
        poses = self.Ts, self.body, known, self.measured_frames()
        self.set_labels(frame, label_frame(self.evidence, frame, *poses, self.logodds, self.rng))

    def relabel_uncertain_frames(self) -> None:
        """Label the most uncertain frames again, now that later frames are known."""
        valid = self.evidence.scene.valid
        frames = [int(i) for i in np.flatnonzero(self.done) if valid[i].any()]
        doubt = np.array([(np.abs(self.logodds[i][valid[i]]) < 1).mean() for i in frames])
        for at in np.argsort(-doubt, kind="stable")[:MAX_RELABELLED]:
            if doubt[at] > UNCERTAIN_SHARE:
                self.label_frame(frames[at])

    def set_labels(self, frame: int, logodds: NDArray[np.float32]) -> None:
        """Set the log-odds (h, w) of a frame, and draw the samples that register other frames to it."""
        scene = self.evidence.scene
        self._record_cache.clear()
        self.logodds[frame] = logodds
        self.labels[frame] = np.where(scene.mask[frame], np.where(logodds > 0, 2, 1), 0)
        for k in range(2):
            sure = self.evidence.usable_pixels(frame, (self.labels[frame] == k + 1) & (np.abs(logodds) > 1))
            self.samples[k][frame] = sample_pixels(sure, SAMPLES, self.rng)
            least = MIN_PART_PIXELS if self.joint is None else MIN_JOINTED_PIXELS
            self.seen[frame, k] = sure.sum() >= least
        self.ambiguous[frame] = is_ambiguous(logodds[scene.valid[frame]])
        ambiguous_samples = self.evidence.usable_pixels(frame, scene.mask[frame] & (np.abs(logodds) <= 1))
        self.ambiguous_samples[frame] = sample_pixels(ambiguous_samples, SAMPLES, self.rng)

    def relative_motion(self) -> float:
        """Metres: range of the second part's motion relative to the first, over the frames done."""
        frames = np.flatnonzero(self.done & self.seen.all(1))
        if len(frames) < 2:
            return 0.0
        body, relative = self.body_points(), se3.inverse(self.Ts[0, frames]) @ self.Ts[1, frames]
        places = se3.transform(relative, np.broadcast_to(body, (len(frames), *body.shape)))
        low, high = np.percentile(places, [5, 95], axis=0)
        return float(np.linalg.norm(high - low, axis=1).max())

    def body_points(self) -> Array:
        """See the function of this name."""
        return body_points(self.evidence, self.labels, self.Ts[1], self.done & self.seen[:, 1])

    def choose_joint(self) -> JointedPoses:
        """Both joint types fitted to the frames done; the better one."""
        arguments = (self.evidence, self.labels, self.Ts, self.seen, self.body_points(), self.done)
        return choose_joint_type(*arguments, self.settings, self.rng)

    def set_joint(self, poses: JointedPoses) -> None:
        """Continue under this joint: the second part takes the first part's canonical frame."""
        self.joint, self.states = poses.joint, poses.states.copy()
        self.Ts = np.stack([poses.Ts, poses.Ts_moving])
        self.body = None

    def current_poses(self) -> JointedPoses:
        """The poses so far."""
        assert self.joint is not None
        return JointedPoses(self.joint, self.states, self.Ts[0], np.full(len(self.states), np.inf), np.inf)


def body_points(evidence: Evidence, labels: NDArray[np.uint8], Ts: Array, seen: NDArray[np.bool_]) -> Array:
    """Six points (6, 3) round the middle of the second part at its radius, in its own frame.

    From the frames `seen` (n,). Raises UnsolvableError when no pixel is the second part's.
    """
    scene, clouds = evidence.scene, [np.zeros((0, 3))]
    for i in map(int, np.flatnonzero(seen)):
        cloud = scene.points[i][(labels[i] == 2) & scene.valid[i]]
        clouds.append(se3.transform(se3.inverse(Ts[i]), cloud[:: max(1, min(50, len(cloud) // 4))]))
    cloud = np.concatenate(clouds)
    if len(cloud) == 0:
        raise UnsolvableError(
            f"no second part: 0 of its pixels have depth in {int(seen.sum())} frames, at least 1 is needed"
        )
    centre = np.median(cloud, axis=0)
    lever = float(np.sqrt(np.mean(np.sum((cloud - centre) ** 2, axis=1))))
    return np.asarray(centre + lever * np.concatenate([np.eye(3), -np.eye(3)]))
