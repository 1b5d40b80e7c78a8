"""Free-moving part segmentation: grow labels and poses of two parts from a seed, both ways in time.

Growth starts free (two poses a frame); as soon as the relative motion says what the joint is, it goes on with six plus
one degrees of freedom. Labels of a frame come from all its pixels: under both motions, against several earlier frames.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.joint import Joint
from freeart21.se3 import Array
from reconstruct import rigid
from reconstruct.evidence import Evidence, Pixels, Samples, draw
from reconstruct.hypotheses import better_type
from reconstruct.labels import SURE, is_open, label_frame, label_frames
from reconstruct.poses import JointedPoses, joint_adjustment
from reconstruct.scene import HopelessError
from reconstruct.seeds import Seed, stepped
from reconstruct.settings import ReconstructSettings
from reconstruct.tracks import Tracker, bilinear


def _last(found: tuple[Array, float, float]) -> float:
    """The cost of a registration."""
    return found[2]


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
    """The state of the growth: poses and labels of the frames done so far."""

    def __init__(
        self, evidence: Evidence, tracker: Tracker, seed: Seed, settings: ReconstructSettings, rng: np.random.Generator
    ) -> None:
        scene = evidence.scene
        self.evidence, self.tracker, self.settings, self.rng = evidence, tracker, settings, rng
        n = len(scene)
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
        self.costs = np.full(n, np.nan)
        self.found_again: list[tuple[int, int]] = []
        self._put_labels(seed.frame, np.clip(seed.logodds, -SURE, SURE))
        self.done[seed.frame] = True
        self._body: Array | None = None
        for j, T in zip(seed.others, seed.Ts, strict=True):
            self.step_free(int(j), int(j) - 1, ([T[0]], [T[1]]))

    # ---- growing -------------------------------------------------------------------------------------------------

    def frontier(self) -> list[tuple[int, int]]:
        """(frame, neighbour already done) at the ends of what is done."""
        frames = np.flatnonzero(self.done)
        ends = [(int(frames[-1]) + 1, int(frames[-1])), (int(frames[0]) - 1, int(frames[0]))]
        return [(i, p) for i, p in ends if 0 <= i < len(self.done)]

    def grow(self, most: int) -> int:
        """Add up to `most` frames, alternating between the two ends; how many were added."""
        added = 0
        while added < most and (ends := self.frontier()):
            for frame, neighbour in ends:
                if self.joint is None:
                    self.step_free(frame, neighbour, tuple(self._predictions(k, frame, neighbour) for k in range(2)))
                else:
                    self.step_jointed(frame, neighbour)
                added += 1
        return added

    def step_free(self, frame: int, neighbour: int, starts: tuple[list[Array], ...]) -> None:
        """Pose both parts of a frame freely, each from the best of several starts, and label it."""
        self.labels[frame] = self._carried(frame, neighbour)
        found: list[Array | None] = []
        for k in range(2):
            best, best_cost = None, np.inf
            for start in starts[k]:
                references = self.references(k, start, frame)
                if len(references) == 0:
                    continue
                T, inliers = self._registered(k, frame, start, references, self.settings.growth.gates)
                cost = self._cost(k, frame, T, references)
                if inliers >= self.settings.growth.min_part_pixels and cost < best_cost:
                    best, best_cost = T, cost
            found.append(best)
        poses = []
        for k in range(2):
            mine, other = found[k], found[1 - k]
            if mine is None:  # a hidden part moves as if fixed to the other
                other = self.Ts[1 - k, neighbour] if other is None else other
                mine = other @ se3.inverse(self.Ts[1 - k, neighbour]) @ self.Ts[k, neighbour]
            poses.append(mine)
        for last in (False, True):
            self.Ts[:, frame] = poses
            self._label(frame)
            for k in range(0 if last else 2):
                references = self.references(k, poses[k], frame)
                if self.seen[frame, k] and len(references):
                    T, inliers = self._registered(k, frame, poses[k], references, (6.0, 5.0, 4.0))
                    poses[k] = T if inliers >= self.settings.growth.min_part_pixels else poses[k]
        self.done[frame] = True
        self._body = None

    def step_jointed(self, frame: int, neighbour: int) -> None:
        """Pose a frame by the reference pose and the joint state, from the best of several starts, and label it."""
        self.labels[frame] = self._carried(frame, neighbour)
        starts, gates = self._starts(frame, neighbour), self.settings.growth.gates
        moving = [self._registered_jointed(frame, T, q, gates) for T, q in starts]
        still = [self._registered_jointed(frame, T, q, gates, True) for T, q in starts if q == self.states[neighbour]]
        T, q, cost = min(moving, key=_last)
        at_rest = min(still, key=_last)
        if not at_rest[2] > self.settings.growth.rest_cost * cost:  # nor is there a motion where nothing is measured
            T, q, cost = at_rest
        rest, parted = q == self.states[neighbour], False
        if self._lost(neighbour):
            T, q, parted = self._parted(frame, neighbour, T, q)
        if parted:
            cost = self._jointed_cost(frame, T, q)
            if self._jumped(q - self.states[neighbour]):
                self.found_again.append((frame, neighbour))
        self._place(frame, T, q)
        self._label(frame)
        if not parted:
            labels = self.labels[frame].copy()
            if self.open[frame]:
                self.labels[frame][np.abs(self.logodds[frame]) <= 1] = 0  # either part may be met there
            T, q, cost = self._registered_jointed(frame, T, q, (6.0, 5.0, 4.0), rest)
            self.labels[frame] = labels
        if self._moved(frame, T, q) > self.settings.growth.same_place * self.evidence.unit:
            self._place(frame, T, q)
            self._label(frame)
        self._place(frame, T, q)
        self.costs[frame] = cost
        self.done[frame] = True

    def go_back(self, frame: int, neighbour: int) -> bool:
        """Grow again from `frame`, where a part was found anew, over `neighbour` to where it had been lost.

        There old and new poses agree; whether they do. If not, all is as before. What lies between is no reference
        until it is grown again.
        """
        back = 1 if neighbour > frame else -1
        doubted = self._doubted(neighbour, back)
        Ts, states, logodds = self.Ts[:, doubted].copy(), self.states[doubted].copy(), self.logodds[doubted].copy()
        costs, seen = self.costs[doubted].copy(), self.seen[doubted].copy()
        self._body = self.body_points() if self._body is None else self._body
        self.done[doubted] = False
        alike = grown = 0
        for i, T, q in zip(doubted, Ts[0], states, strict=True):
            self.step_jointed(int(i), int(i) - back)
            grown += 1
            near = self._moved(int(i), T, q) < self.settings.growth.agreeing * self.evidence.unit
            alike = alike + 1 if near else 0
            if alike == self.settings.growth.agreeing_frames:
                break
        agreed = alike == self.settings.growth.agreeing_frames
        for c, i in enumerate(doubted[:grown]):
            if not agreed:
                self.Ts[:, i], self.states[i] = Ts[:, c], states[c]
                self._put_labels(int(i), logodds[c])
                self.costs[i], self.seen[i] = costs[c], seen[c]
        self.done[doubted] = True
        self._body = None
        return agreed

    def _doubted(self, frame: int, back: int) -> NDArray[np.int64]:
        """The frames from `frame` on in the direction `back` until, and with, a run that shows both parts clearly."""
        s, valid = self.settings.growth, self.evidence.scene.valid
        run, frames = 0, []
        while 0 <= frame < len(self.done) and self.done[frame] and run < s.sound_frames:
            known = np.abs(self.logodds[frame][valid[frame]]) >= 1
            second = (self.logodds[frame][valid[frame]] >= 1).sum() / max(known.sum(), 1)
            sound = len(known) and known.mean() > 1 - s.doubtful and s.sound_share < second < 1 - s.sound_share
            run = run + 1 if sound and self.seen[frame].all() else 0
            frames.append(frame)
            frame += back
        return np.array(frames, int)

    # ---- predictions ---------------------------------------------------------------------------------------------

    def _predictions(self, k: int, frame: int, neighbour: int) -> list[Array]:
        """Starts of one part's pose: constant velocity, standing still, the other part's velocity, and the tracks."""
        T, before = self.Ts[:, neighbour], 2 * neighbour - frame
        starts = [T[k]]
        if 0 <= before < len(self.done) and self.done[before]:
            starts += [T[m] @ se3.inverse(self.Ts[m, before]) @ T[k] for m in (k, 1 - k)]
        tracked = self._tracked(k, frame, neighbour)
        return starts if tracked is None else [*starts, tracked @ T[k]]

    def _starts(self, frame: int, neighbour: int) -> list[tuple[Array, float]]:
        """Starts of reference pose and state."""
        assert self.joint is not None
        T, q, before = self.Ts[0, neighbour], self.states[neighbour], 2 * neighbour - frame
        starts = [(T, q)]
        ahead = q
        if 0 <= before < len(self.done) and self.done[before] and not self._jumped(q - self.states[before]):
            ahead = 2 * q - self.states[before]
            velocity = T @ se3.inverse(self.Ts[0, before])
            starts += [(velocity @ T, ahead), (velocity @ T, q)]
        for k in range(2):
            tracked = self._tracked(k, frame, neighbour)
            if tracked is not None:
                moved = tracked @ self.Ts[k, neighbour]
                starts.append((moved if k == 0 else moved @ se3.inverse(self.joint.transform(ahead)), ahead))
        return [(se3.orthonormalised(T), q) for T, q in starts]

    def _lost(self, frame: int) -> bool:
        """Whether a part was not seen in `frame`, or what was seen fits worse than it mostly does."""
        usual = np.nanmedian(self.costs) if np.isfinite(self.costs).any() else np.inf
        return bool(not self.seen[frame].all() or self.costs[frame] > self.settings.growth.surprising_cost * usual)

    def _parted(self, frame: int, neighbour: int, T: Array, q: float) -> tuple[Array, float, bool]:
        """Reference pose and state that explain the pixels of `frame` best at any state met so far, without labels.

        A pixel follows the motion that explains it better. Beyond the states met so far the parts might be taken for
        each other: a lid that opens looks like a box that closes past its lid. `T` and `q` come back, and False, when
        little is gained. After a frame whose labels were in doubt growth goes on so, at least at rest.
        """
        assert self.joint is not None
        settings = self.settings.growth
        known = np.flatnonzero(self._measured())  # others call all one part, and would agree to it
        pixels = draw(self.evidence.scene.valid[frame], settings.samples, self.rng)
        if len(pixels) == 0 or len(known) == 0:
            return T, q, False
        turn = np.minimum(
            *(rigid.view_angle(self.Ts[k, known, :3, :3], T_k[:3, :3]) for k, T_k in enumerate(self._both(T, q)))
        )
        turn += np.where(np.abs(known - frame) < settings.look_back, 1.0, 0)  # a joint that starts to move is slow
        others = np.sort(known[np.argsort(turn, kind="stable")[: 2 * settings.references : 2]])
        low, high = np.percentile(self.states[known], [1, 99])
        grid = np.linspace(float(low), float(high), settings.searched_states)
        found = still = self._refined_freely(frame, others, pixels, T, q, at_rest=True)
        before = best = float(self._freely(frame, others, pixels, found[0][None], np.array([q])).min(2).mean())
        turned = self.joint.transform(q) @ se3.inverse(self.joint.transform(grid))
        for Ts in (np.tile(T, (len(grid), 1, 1)), T @ turned):  # either part stands still
            explained = self._freely(frame, others, pixels, Ts, grid).min(2).mean(0)
            for g in np.argsort(explained, kind="stable")[:2]:
                start = self._refined_freely(frame, others, pixels, Ts[g], float(grid[g]))
                cost = float(self._freely(frame, others, pixels, start[0][None], np.array([start[1]])).min(2).mean())
                if cost < best:
                    best, found = cost, start
        gained = best < settings.found_cost * before and best < before - self.settings.seeds.min_gain
        if self.open[neighbour] and not self._jumped(found[1] - q):  # labels say little: go on without
            gained = settings.rest_cost * best < before
        if gained and self._same_parts(frame, neighbour, others, pixels, *found):
            return *found, True
        return (*still, True) if self.open[neighbour] else (T, q, False)

    def _measured(self) -> NDArray[np.bool_]:
        """(n,) the frames done whose joint is known, not guessed."""
        return self.done & (np.asarray(self.seen.all(1)) | self.open)

    def _same_parts(
        self, frame: int, neighbour: int, others: NDArray[np.int64], pixels: Pixels, T: Array, q: float
    ) -> bool:
        """Whether the labels that flow carried here agree with what `T` and `q` say: else the parts are exchanged.

        Of a part that was hidden flow carries nothing: most pixels, at least, are the other's still. Where all was in
        doubt either part may be either, and nothing speaks against.
        """
        costs = self._freely(frame, others, pixels, T[None], np.array([q]))[:, 0]
        carried = self.labels[frame, pixels[:, 0], pixels[:, 1]]
        told = (carried > 0) & (np.abs(costs[:, 1] - costs[:, 0]) > 0.3)
        agree = (costs.argmin(1) + 1 == carried)[told]
        if len(agree) < self.settings.growth.min_jointed_pixels:
            return bool(self.open[neighbour])
        return bool(agree.mean() > (0.8 if self.seen[neighbour].all() else 0.5))

    def _both(self, T: Array, q: float) -> tuple[Array, Array]:
        """Poses of both parts."""
        assert self.joint is not None
        return T, T @ self.joint.transform(q)

    def _freely(self, frame: int, others: NDArray[np.int64], pixels: Pixels, Ts: Array, states: Array) -> Array:
        """(p, m, 2) costs of `pixels` of `frame` as either part's, for m reference poses and states; no labels."""
        assert self.joint is not None
        here = np.stack([Ts, Ts @ self.joint.transform(states)], 1)
        there = np.swapaxes(self.Ts[:, others], 0, 1)[:, None]
        motions = (there @ se3.inverse(here)[None]).reshape(len(others), -1, 4, 4)
        costs = self.evidence.costs(frame, others, motions, pixels).mean(1)
        return costs.reshape(len(pixels), len(Ts), 2)

    def _refined_freely(
        self, frame: int, others: NDArray[np.int64], pixels: Pixels, T: Array, q: float, at_rest: bool = False
    ) -> tuple[Array, float]:
        """Reference pose and state after Gauss-Newton on pixels that choose their part anew in every round."""
        assert self.joint is not None
        most = self._longest_step()
        for gate in (12.0, 8.0, 6.0, 5.0):
            second = self._freely(frame, others, pixels, T[None], np.array([q]))[:, 0].argmin(1) == 1
            A, b = np.zeros((7, 7)), np.zeros(7)
            for k, T_k in enumerate(self._both(T, q)):
                mine = {frame: pixels[second == bool(k)]}
                motions = self.Ts[k, others] @ se3.inverse(T_k)
                H, g, _ = self.evidence.register(np.full(len(others), frame), others, motions, mine, gate)
                back = -se3.adjoint(motions)
                M = np.eye(6, 7)
                M[:, 6] = se3.adjoint(T) @ self.joint.screw if k else 0
                M = back @ M
                A += np.einsum("pia,pij,pjb->ab", M, H, M)
                b += np.einsum("pia,pi->a", M, g)
            if at_rest:
                A[6], A[:, 6], b[6] = 0, 0, 0
            T, q = self._stepped(T, q, A, b, most)
        return T, q

    def _stepped(self, T: Array, q: float, A: Array, b: Array, most: float) -> tuple[Array, float]:
        """Reference pose and state after one damped Gauss-Newton step, at most `most` of the state."""
        diagonal = np.diag(A)
        x = -np.linalg.solve(A + np.diag(1e-3 * diagonal + 1e-9 * diagonal.max() + 1e-300), b)
        x[:6] *= min(1.0, 0.1 / max(float(np.linalg.norm(x[3:6])), 1e-12))
        return se3.orthonormalised(se3.exp_se3(x[:6]) @ T), q + float(np.clip(x[6], -most, most))

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
        if abs(a - b) != 1 or self._jumped(self.states[a] - self.states[b]):
            return float(self.states[a])
        return float(2 * self.states[a] - self.states[b])

    # ---- registration --------------------------------------------------------------------------------------------

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
        return self.done & (np.abs(self.states - self.states[frame]) < 0.05 * self._longest_step())

    def _samples(self, k: int, reference: int, frame: int) -> NDArray[np.int32]:
        """Pixels of part k in `reference` to be met in `frame`; with the first part go those that might be either's."""
        if k == 1 or not self._as_one(frame)[reference]:
            return self.samples[k][reference]
        return np.concatenate([self.samples[0][reference], self.unsure[reference]])

    def _terms(
        self, k: int, frame: int, T: Array, references: NDArray[np.int64], gate: float
    ) -> tuple[Array, Array, Array]:
        """Summed Gauss-Newton terms of the left twist of part k's pose in `frame`, from the references' samples."""
        relative = T @ se3.inverse(self.Ts[k, references])
        samples = {int(r): self._samples(k, int(r), frame) for r in references}
        H, g, stats = self.evidence.register(
            references,
            np.full(len(references), frame),
            relative,
            samples,
            gate,
            self.labels,
            k + 1,
        )
        return H.sum(0), g.sum(0), stats.sum(0)

    def _registered(
        self, k: int, frame: int, T: Array, references: NDArray, gates: tuple[float, ...]
    ) -> tuple[Array, float]:
        """Part k's pose after Gauss-Newton through the gates, and inliers per reference."""
        stats = np.zeros(4)
        for gate in gates:
            H, g, stats = self._terms(k, frame, T, references, gate)
            T = stepped(T, H, g)
        return T, stats[0] / len(references)

    def _registered_jointed(
        self, frame: int, T: Array, q: float, gates: tuple[float, ...], at_rest: bool = False
    ) -> tuple[Array, float, float]:
        """Reference pose and state after Gauss-Newton with six plus one unknowns, and their cost.

        With `at_rest` the state stays: the object moves as one body.
        """
        assert self.joint is not None
        self.states[frame] = q
        both = self._both(T, q)
        references = [self.references(k, both[k], frame) for k in range(2)]
        most = self._longest_step()
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
            T, q = self._stepped(T, q, A, b, most)
        return T, q, self._jointed_cost(frame, T, q)

    def _jointed_cost(self, frame: int, T: Array, q: float) -> float:
        """What the parts' samples cost in `frame`, and the pixels of `frame` under the motion that explains them."""
        both = self._both(T, q)
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

    def _jumped(self, step: float) -> bool:
        """Whether a state that changes so from one frame to the next had been lost: no hand is so fast."""
        assert self.joint is not None
        return bool(abs(step) > (0.2 if self.joint.type == "revolute" else 0.06 * self.evidence.scene.diagonal))

    def _longest_step(self) -> float:
        """Radians or metres by which a state may change at once."""
        assert self.joint is not None
        return 0.1 if self.joint.type == "revolute" else 0.1 * self.evidence.scene.diagonal

    def _pixel_costs(self, k: int, frame: int, T: Array, references: NDArray[np.int64]) -> Array:
        """Costs of a third of the references' samples when part k stands at `T` in `frame`."""
        parts = []
        for r in map(int, references):
            motion, pixels = (T @ se3.inverse(self.Ts[k, r]))[None, None], self._samples(k, r, frame)[::3]
            parts.append(self.evidence.costs(r, np.array([frame]), motion, pixels)[:, 0, 0])
        return np.concatenate(parts) if parts else np.zeros(0)

    def _cost(self, k: int, frame: int, T: Array, references: NDArray[np.int64]) -> float:
        costs = self._pixel_costs(k, frame, T, references)
        return float(costs.mean()) if len(costs) else np.inf

    # ---- labels --------------------------------------------------------------------------------------------------

    def _carried(self, frame: int, neighbour: int) -> NDArray[np.uint8]:
        """Labels (h, w) that the flow brings from a neighbour; 0 where it disagrees with itself.

        With them a part that is about to vanish cannot slip onto the surface of the other.
        """
        direction = neighbour - frame
        h, w = self.evidence.scene.mask.shape[1:]
        at = np.argwhere(np.ones((h, w), bool))[:, ::-1].astype(float)
        there = at + self.tracker.step(frame, direction).reshape(-1, 2).astype(float)
        round_trip = np.linalg.norm(there + bilinear(self.tracker.step(neighbour, -direction), there) - at, axis=1)
        x = np.clip(np.rint(there[:, 0]).astype(int), 0, w - 1)
        y = np.clip(np.rint(there[:, 1]).astype(int), 0, h - 1)
        sure = (round_trip < self.settings.tracks.max_round_trip) & (np.abs(self.logodds[neighbour, y, x]) > 1)
        return np.where(sure, self.labels[neighbour, y, x], 0).reshape(h, w).astype(np.uint8)

    def _moved(self, frame: int, T: Array, q: float) -> float:
        """Metres by which points round the second part move, as either part's, when reference pose and state change."""
        body = self.body_points() if self._body is None else self._body
        now = [se3.transform(T_k, body) for T_k in self._both(T, q)]
        was = [se3.transform(T_k, body) for T_k in self.Ts[:, frame]]
        return float(np.linalg.norm(np.subtract(now, was), axis=2).max())

    def _place(self, frame: int, T: Array, q: float) -> None:
        assert self.joint is not None
        self.Ts[0, frame], self.states[frame] = T, q
        self.Ts[1, frame] = T @ self.joint.transform(q)

    def _label(self, frame: int) -> None:
        """Labels of `frame` from all its pixels under both motions to the frames done."""
        known = self.done & (self.seen.any(1) | self.open)
        self._body = self.body_points() if self._body is None else self._body
        asked = self._body, known, self._measured()
        self._put_labels(frame, label_frame(self.evidence, frame, self.Ts, *asked, self.logodds, self.rng))

    def relabel_doubtful(self) -> None:
        """Label the frames anew that knew least of themselves: what came after them may tell."""
        valid = self.evidence.scene.valid
        frames = [int(i) for i in np.flatnonzero(self.done) if valid[i].any()]
        doubt = np.array([(np.abs(self.logodds[i][valid[i]]) < 1).mean() for i in frames])
        for at in np.argsort(-doubt, kind="stable")[: self.settings.growth.doubtful_most]:
            if doubt[at] > self.settings.growth.doubtful:
                self._label(frames[at])

    def _put_labels(self, frame: int, logodds: NDArray[np.float32]) -> None:
        scene, settings = self.evidence.scene, self.settings.growth
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

    # ---- the joint -----------------------------------------------------------------------------------------------

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
        self._body = None

    def jointed(self) -> JointedPoses:
        """The present poses."""
        assert self.joint is not None
        return JointedPoses(self.joint, self.states, self.Ts[0], np.full(len(self.states), np.inf), np.inf)


def grow(
    evidence: Evidence, tracker: Tracker, seed: Seed, settings: ReconstructSettings, rng: np.random.Generator
) -> Grown:
    """Labels, poses and joint of the whole recording from one seed.

    Raises HopelessError when the second part never moves against the first.
    """
    growth = Growth(evidence, tracker, seed, settings, rng)
    s = settings.growth
    growth.grow(s.bootstrap_frames - int(growth.done.sum()))
    enough = s.bootstrap_motion * evidence.scene.diagonal
    while growth.relative_motion() < enough and growth.done.sum() < s.bootstrap_most and growth.frontier():
        growth.grow(4)
    if (growth.done & growth.seen.all(1)).sum() < 4:
        raise HopelessError("segmentation", "no second part: fewer than 4 frames show two parts")
    growth.adopt(growth.try_joint())
    roughly = replace(settings.poses, samples=s.adjust_samples)
    while growth.frontier():
        growth.grow(s.adjust_every)
        found, growth.found_again = growth.found_again, []
        for pair in found:
            growth.go_back(*pair)
        growth.found_again.clear()  # what the way back found leads nowhere new
        growth.relabel_doubtful()
        growth.adopt(
            joint_adjustment(evidence, growth.labels, growth.jointed(), growth.seen, roughly, rng, 4, growth.done)
        )
    return Grown(growth.jointed(), growth.labels, growth.logodds, growth.seen)


def relabel(evidence: Evidence, grown: Grown, settings: ReconstructSettings, rng: np.random.Generator) -> Grown:
    """Labels of all frames anew, given all poses."""
    Ts = np.stack([grown.poses.Ts, grown.poses.Ts_moving])
    body = body_points(evidence, grown.labels, Ts[1], grown.seen[:, 1])
    logodds = label_frames(evidence, Ts, body, grown.seen, grown.logodds, rng)
    scene, least = evidence.scene, settings.growth.min_jointed_pixels
    labels = np.where(scene.mask, (logodds > 0) + np.uint8(1), np.uint8(0))
    sure = np.abs(logodds) > 1
    seen = [[evidence.usable(i, (labels[i] == k) & sure[i]).sum() >= least for k in (1, 2)] for i in range(len(labels))]
    return replace(grown, labels=labels, logodds=logodds, seen=np.array(seen))


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
        raise HopelessError("segmentation", "no second part: no frame shows enough of it")
    centre = np.median(cloud, axis=0)
    lever = float(np.sqrt(np.mean(np.sum((cloud - centre) ** 2, axis=1))))
    return np.asarray(centre + lever * np.concatenate([np.eye(3), -np.eye(3)]))
