"""What growth knows of the frames done so far, and how a frame is registered and labelled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.joint import Joint
from freeart21.se3 import Array
from reconstruct import rigid
from reconstruct.evidence import Evidence, Records, Samples, draw
from reconstruct.hypotheses import better_type
from reconstruct.labels import SURE, is_open, label_frame
from reconstruct.poses import JointedPoses
from reconstruct.scene import HopelessError
from reconstruct.seeds import Seed, stepped
from reconstruct.settings import ReconstructSettings
from reconstruct.tracks import Tracker, bilinear


@dataclass(frozen=True)
class Grown:
    """Both parts in every frame."""

    poses: JointedPoses
    labels: NDArray[np.uint8]
    """(n, h, w): 0 neither, 1 first part, 2 second part."""
    logodds: NDArray[np.float32]
    """(n, h, w) > 0 where the second part is."""
    seen: NDArray[np.bool_]
    """(n, 2) whether each part shows enough pixels."""


class Growth:
    """What is known so far: poses and labels of the frames done."""

    def __init__(
        self,
        evidence: Evidence,
        tracker: Tracker,
        seed: Seed,
        settings: ReconstructSettings,
        rng: np.random.Generator,
        span: tuple[int, int] | None = None,
    ) -> None:
        scene = evidence.scene
        self.evidence, self.tracker, self.settings, self.rng = evidence, tracker, settings, rng
        n = len(scene)
        self.span = (0, n - 1) if span is None else span
        """First and last frame that may be grown."""
        self.Ts = np.tile(np.eye(4), (2, n, 1, 1))
        self.states = np.zeros(n)
        self.joint: Joint | None = None
        self.logodds = np.zeros(scene.mask.shape, np.float32)
        self.labels = np.zeros(scene.mask.shape, np.uint8)
        self.done = np.zeros(n, bool)
        self.seen = np.zeros((n, 2), bool)
        self.open = np.zeros(n, bool)
        self.samples: tuple[Samples, Samples] = ({}, {})
        self.unsure: Samples = {}
        self._kept_records: dict[tuple[int, bytes, bytes], Records] = {}
        self.costs = np.full(n, np.nan)
        self.found_again: list[tuple[int, int]] = []
        self.put_labels(seed.frame, np.clip(seed.logodds, -SURE, SURE))
        self.done[seed.frame] = True
        self.body: Array | None = None
        """Points of the second part, as `body_points` finds them; None when they are to be found anew."""

    def references(self, k: int, T: Array, frame: int, most: int | None = None) -> NDArray[np.int64]:
        """Frames to register part `k` of `frame` against: the nearest in time, and those of the most similar view."""
        settings = self.settings.growth
        most = settings.references if most is None else most
        known = np.flatnonzero(self.done & (self.seen[:, k] | (self._as_one(frame) if k == 0 else False)))
        known = known[known != frame]
        if len(known) == 0:
            return known
        turn = rigid.view_angle(self.Ts[k, known, :3, :3], T[:3, :3])
        chosen = [int(i) for i in known[np.argsort(np.abs(known - frame), kind="stable")[:2]]]
        for c in np.argsort(turn + 0.004 * np.minimum(np.abs(known - frame), 20), kind="stable"):
            if len(chosen) >= most or turn[c] > np.radians(settings.max_turn_deg):
                break
            if all(abs(known[c] - other) > 2 for other in chosen):
                chosen.append(int(known[c]))
        return np.array(sorted(set(chosen)), int)

    def _as_one(self, frame: int) -> NDArray[np.bool_]:
        """(n,) frames in which the joint stands as in `frame`: whatever part a pixel is of, it moved as the first did.

        By the state that `frame` has for now. Always false before the joint is known.
        """
        if self.joint is None:
            return np.zeros(len(self.done), bool)
        return self.done & (np.abs(self.states - self.states[frame]) < 0.05 * self.longest_step())

    def _samples(self, k: int, references: NDArray[np.int64], frame: int) -> Samples:
        """Pixels of part k in `references` to be met in `frame`; with the first part go those that may be either's."""
        found = {int(r): self.samples[k][int(r)] for r in references}
        for r in references[self._as_one(frame)[references]] if k == 0 else ():
            found[int(r)] = np.concatenate([found[int(r)], self.unsure[int(r)]])
        return found

    def _records(self, k: int, references: NDArray[np.int64], frame: int) -> Records:
        """The records of `_samples`, kept until samples are drawn anew: a frame is registered from many starts."""
        together = self._as_one(frame)[references] if k == 0 else references[:0]
        key = k, references.tobytes(), together.tobytes()
        if key not in self._kept_records:
            self._kept_records[key] = self.evidence.records(self._samples(k, references, frame))
        return self._kept_records[key]

    def _terms(
        self, k: int, frame: int, T: Array, references: NDArray[np.int64], gate: float
    ) -> tuple[Array, Array, Array]:
        """Summed Gauss-Newton terms of the left twist of part k's pose in `frame`, from the references' samples."""
        relative = T @ se3.inverse(self.Ts[k, references])
        records, here = self._records(k, references, frame), np.full(len(references), frame)
        H, g, stats = self.evidence.register(references, here, relative, records, gate, self.labels, k + 1)
        return H.sum(0), g.sum(0), stats.sum(0)

    def registered(
        self, k: int, frame: int, T: Array, references: NDArray, gates: tuple[float, ...]
    ) -> tuple[Array, float]:
        """Part k's pose after Gauss-Newton through the gates, and inliers per reference."""
        stats = np.zeros(4)
        for gate in gates:
            H, g, stats = self._terms(k, frame, T, references, gate)
            T = stepped(T, H, g)
        return T, stats[0] / len(references)

    def registered_jointed(
        self, frame: int, T: Array, q: float, gates: tuple[float, ...], at_rest: bool = False
    ) -> tuple[Array, float, float]:
        """Reference pose and state after Gauss-Newton with six plus one unknowns, and their cost.

        With `at_rest` the state stays: the object moves as one body.
        """
        assert self.joint is not None
        self.states[frame] = q
        both = self.both(T, q)
        references = [self.references(k, both[k], frame) for k in range(2)]
        most = self.longest_step()
        expected, stray = self._expected_state(frame), self.settings.growth.state_surprise * 10 * most
        pull = self.settings.growth.surprise_weight / stray**2
        for gate in gates:
            A, b = np.zeros((7, 7)), np.zeros(7)
            A[6, 6], b[6] = pull, pull * (q - expected)
            for k in range(2):
                if len(references[k]) == 0:
                    continue
                M = np.eye(6, 7)
                M[:, 6] = se3.adjoint(T) @ self.joint.screw if k else 0
                H, g, _ = self._terms(k, frame, T @ self.joint.transform(q) if k else T, references[k], gate)
                A += M.T @ H @ M
                b += M.T @ g
            if at_rest:
                A[6], A[:, 6], b[6] = 0, 0, 0
            T, q = self.stepped_jointed(T, q, A, b, most)
        return T, q, self.jointed_cost(frame, T, q)

    def stepped_jointed(self, T: Array, q: float, A: Array, b: Array, most: float) -> tuple[Array, float]:
        """Reference pose and state after one damped Gauss-Newton step, at most `most` of the state."""
        diagonal = np.diag(A)
        x = -np.linalg.solve(A + np.diag(1e-3 * diagonal + 1e-9 * diagonal.max() + 1e-300), b)
        x[:6] *= min(1.0, 0.1 / max(float(np.linalg.norm(x[3:6])), 1e-12))
        return se3.orthonormalised(se3.exp_se3(x[:6]) @ T), q + float(np.clip(x[6], -most, most))

    def jointed_cost(self, frame: int, T: Array, q: float) -> float:
        """What the parts' samples cost in `frame`, and the pixels of `frame` under the motion that explains them."""
        both = self.both(T, q)
        references = [self.references(k, both[k], frame) for k in range(2)]
        costs = [self._pixel_costs(k, frame, both[k], references[k]) for k in range(2)]
        if not sum(map(len, costs)):
            return np.inf
        return float(np.concatenate(costs).mean()) + self._unexplained(frame, both, references)

    def _unexplained(self, frame: int, both: tuple[Array, Array], references: list[NDArray[np.int64]]) -> float:
        """Mean cost of the pixels of `frame`, each under the motion that explains it better."""
        pixels = np.argwhere(self.evidence.scene.valid[frame])
        if len(pixels) == 0:
            return 0.0
        pixels = pixels[:: max(1, len(pixels) // self.settings.growth.samples)]
        costs = []
        for k, others in enumerate(references):
            if len(others):
                T = (self.Ts[k, others] @ se3.inverse(both[k]))[:, None].repeat(2, 1)
                found = self.evidence.costs(frame, others, T, pixels, self.logodds, 0.5)
                costs.append(found[:, :, k].mean(1))
        return float(np.min(costs, axis=0).mean())

    def _pixel_costs(self, k: int, frame: int, T: Array, references: NDArray[np.int64]) -> Array:
        """Costs of a third of the references' samples when part k stands at `T` in `frame`."""
        parts = []
        for r, pixels in self._samples(k, references, frame).items():
            motion = (T @ se3.inverse(self.Ts[k, r]))[None, None]
            parts.append(self.evidence.costs(r, np.array([frame]), motion, pixels[::3])[:, 0, 0])
        return np.concatenate(parts) if parts else np.zeros(0)

    def cost(self, k: int, frame: int, T: Array, references: NDArray[np.int64]) -> float:
        """What part k's samples cost on average when it stands at `T` in `frame`."""
        costs = self._pixel_costs(k, frame, T, references)
        return float(costs.mean()) if len(costs) else np.inf

    def predictions(self, k: int, frame: int, neighbour: int) -> list[Array]:
        """Starts of one part's pose: constant velocity, standing still, the other part's velocity, and the tracks."""
        T, before = self.Ts[:, neighbour], 2 * neighbour - frame
        starts = [T[k]]
        if 0 <= before < len(self.done) and self.done[before]:
            starts += [T[m] @ se3.inverse(self.Ts[m, before]) @ T[k] for m in (k, 1 - k)]
        tracked = self._tracked(k, frame, neighbour)
        return starts if tracked is None else [*starts, tracked @ T[k]]

    def starts(self, frame: int, neighbour: int) -> list[tuple[Array, float]]:
        """Starts of reference pose and state."""
        assert self.joint is not None
        T, q, before = self.Ts[0, neighbour], self.states[neighbour], 2 * neighbour - frame
        starts = [(T, q)]
        ahead = q
        if 0 <= before < len(self.done) and self.done[before] and not self.jumped(q - self.states[before]):
            ahead = 2 * q - self.states[before]
            velocity = T @ se3.inverse(self.Ts[0, before])
            starts += [(velocity @ T, ahead), (velocity @ T, q)]
        for k in range(2):
            tracked = self._tracked(k, frame, neighbour)
            if tracked is not None:
                moved = tracked @ self.Ts[k, neighbour]
                starts.append((moved if k == 0 else moved @ se3.inverse(self.joint.transform(ahead)), ahead))
        return [(se3.orthonormalised(T), q) for T, q in starts]

    def _tracked(self, k: int, frame: int, neighbour: int) -> Array | None:
        """The motion of one part from `neighbour` to `frame` by its tracks."""
        pixels = self.samples[k].get(neighbour)
        if pixels is None or len(pixels) < 40:
            return None
        direction = frame - neighbour
        tracks = self.tracker.follow(neighbour, 1, direction, pixels)
        kept = tracks.visible[:, -1]
        if kept.sum() < 25:
            return None
        return rigid.ransac_fit(tracks.points[kept, 0], tracks.points[kept, -1], 3 * self.evidence.unit, self.rng)

    def _expected_state(self, frame: int) -> float:
        """The state of `frame` if the joint moves on evenly from the two nearest frames done."""
        known = np.flatnonzero(self.done)
        near = known[np.argsort(np.abs(known - frame), kind="stable")]
        a, b = near[0], near[min(1, len(near) - 1)]
        if abs(a - b) != 1 or self.jumped(self.states[a] - self.states[b]):
            return float(self.states[a])
        return float(2 * self.states[a] - self.states[b])

    def both(self, T: Array, q: float) -> tuple[Array, Array]:
        """Poses of both parts."""
        assert self.joint is not None
        return T, T @ self.joint.transform(q)

    def jumped(self, step: float) -> bool:
        """Whether a state that changes so from one frame to the next had been lost: no hand is so fast."""
        assert self.joint is not None
        return bool(abs(step) > (0.2 if self.joint.type == "revolute" else 0.06 * self.evidence.scene.diagonal))

    def longest_step(self) -> float:
        """Radians or metres by which a state may change at once."""
        assert self.joint is not None
        return 0.1 if self.joint.type == "revolute" else 0.1 * self.evidence.scene.diagonal

    def moved(self, frame: int, T: Array, q: float) -> float:
        """Metres by which points round the second part move, as either part's, when reference pose and state change."""
        body = self.body_points() if self.body is None else self.body
        now = [se3.transform(T_k, body) for T_k in self.both(T, q)]
        was = [se3.transform(T_k, body) for T_k in self.Ts[:, frame]]
        return float(np.linalg.norm(np.subtract(now, was), axis=2).max())

    def place(self, frame: int, T: Array, q: float) -> None:
        """Put both parts of a frame where reference pose and state say."""
        assert self.joint is not None
        self.Ts[0, frame], self.states[frame] = T, q
        self.Ts[1, frame] = T @ self.joint.transform(q)

    def measured(self) -> NDArray[np.bool_]:
        """(n,) the frames done whose joint is known, not guessed."""
        return self.done & (np.asarray(self.seen.all(1)) | self.open)

    def carried(self, frame: int, neighbour: int) -> NDArray[np.uint8]:
        """Labels (h, w) that the flow brings from a neighbour; 0 off the mask and where flow disagrees with itself.

        With them a part that is about to vanish cannot slip onto the surface of the other.
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

    def label(self, frame: int) -> None:
        """Labels of `frame` from all its pixels under both motions to the frames done."""
        known = self.done & (self.seen.any(1) | self.open)
        self.body = self.body_points() if self.body is None else self.body
        asked = self.body, known, self.measured()
        self.put_labels(frame, label_frame(self.evidence, frame, self.Ts, *asked, self.logodds, self.rng))

    def relabel_doubtful(self) -> None:
        """Label the frames anew that knew least of themselves: what came after them may tell."""
        valid = self.evidence.scene.valid
        frames = [int(i) for i in np.flatnonzero(self.done) if valid[i].any()]
        doubt = np.array([(np.abs(self.logodds[i][valid[i]]) < 1).mean() for i in frames])
        for at in np.argsort(-doubt, kind="stable")[: self.settings.growth.doubtful_most]:
            if doubt[at] > self.settings.growth.doubtful:
                self.label(frames[at])

    def put_labels(self, frame: int, logodds: NDArray[np.float32]) -> None:
        """Believe these log-odds (h, w) of a frame, and draw the samples that register other frames to it."""
        scene, settings = self.evidence.scene, self.settings.growth
        self._kept_records.clear()
        self.logodds[frame] = logodds
        self.labels[frame] = np.where(scene.mask[frame], np.where(logodds > 0, 2, 1), 0)
        for k in range(2):
            sure = self.evidence.usable(frame, (self.labels[frame] == k + 1) & (np.abs(logodds) > 1))
            self.samples[k][frame] = draw(sure, settings.samples, self.rng)
            least = settings.min_part_pixels if self.joint is None else settings.min_jointed_pixels
            self.seen[frame, k] = sure.sum() >= least
        self.open[frame] = is_open(logodds[scene.valid[frame]])
        unsure = self.evidence.usable(frame, scene.mask[frame] & (np.abs(logodds) <= 1))
        self.unsure[frame] = draw(unsure, settings.samples, self.rng)

    def relative_motion(self) -> float:
        """Metres: how far the second part has moved against the first, over the frames done."""
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

    def try_joint(self) -> JointedPoses:
        """Both joint types fitted to the end on the frames done; the better one."""
        arguments = (self.evidence, self.labels, self.Ts, self.seen, self.body_points(), self.done)
        return better_type(*arguments, self.settings, self.rng)

    def adopt(self, poses: JointedPoses) -> None:
        """Go on under this joint: the second part takes the first part's canonical frame."""
        self.joint, self.states = poses.joint, poses.states.copy()
        self.Ts = np.stack([poses.Ts, poses.Ts_moving])
        self.body = None

    def jointed(self) -> JointedPoses:
        """The present poses."""
        assert self.joint is not None
        return JointedPoses(self.joint, self.states, self.Ts[0], np.full(len(self.states), np.inf), np.inf)


def body_points(evidence: Evidence, labels: NDArray[np.uint8], Ts: Array, seen: NDArray[np.bool_]) -> Array:
    """Six points (6, 3) round the middle of the second part, at its radius, in its own frame.

    From the frames that have `seen` (n,) it. Raises HopelessError when no pixel is the second part's.
    """
    scene, clouds = evidence.scene, [np.zeros((0, 3))]
    for i in map(int, np.flatnonzero(seen)):
        cloud = scene.points[i][(labels[i] == 2) & scene.valid[i]]
        clouds.append(se3.transform(se3.inverse(Ts[i]), cloud[:: max(1, min(50, len(cloud) // 4))]))
    cloud = np.concatenate(clouds)
    if len(cloud) == 0:
        raise HopelessError(
            f"no second part: 0 of its pixels have depth in {int(seen.sum())} frames, at least 1 is needed"
        )
    centre = np.median(cloud, axis=0)
    lever = float(np.sqrt(np.mean(np.sum((cloud - centre) ** 2, axis=1))))
    return np.asarray(centre + lever * np.concatenate([np.eye(3), -np.eye(3)]))
