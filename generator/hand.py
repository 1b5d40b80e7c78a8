"""A hand with a forearm that holds the object, changes its grip, and occludes what is behind it.

The hand consists of tapered rods with the proportions of a real hand. Its frame: origin in the middle of the palm, x
towards the fingers, z out of the palm. All lengths are those of a hand 21 cm long, times `Hand.scale`: 17 to 20 cm for
objects of real size, larger for objects of PartNet's scale (`LARGE_M`).

The hand grips the side of the object with more visible pixels (usually the reference part) at its rim as seen from the
camera, thumb on one face and fingers on the other, and moves with it. Every few seconds it changes the grip, more often
where no grip is good for long. For each stretch several random grips are scored, and the best is taken: it hides the
wanted share of the object, little of the moving part, does not collide, and bends the wrist little; the arm comes from
below. The size of the hand is fixed: it may hide less of a large object and more of a tiny one.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import cv2
import numba
import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.joint import Joint
from freeart21.mesh import Mesh, bounding_diagonal, join_meshes, triangle_normals
from freeart21.se3 import Array
from generator.motion import Plan
from generator.rays import Caster
from generator.scene import Skin
from generator.shapes import triangles

LENGTHS = np.array(
    [
        [0.046, 0.034, 0.026],  # thumb: metacarpal, proximal, distal
        [0.042, 0.026, 0.021],  # index: proximal, middle, distal
        [0.047, 0.030, 0.022],
        [0.043, 0.028, 0.022],
        [0.034, 0.021, 0.019],
    ]
)
"""(5, 3) bones of the digits, metres."""
RADII = np.array(
    [
        [0.0150, 0.0118, 0.0108, 0.0078],
        [0.0108, 0.0092, 0.0084, 0.0064],
        [0.0110, 0.0094, 0.0086, 0.0066],
        [0.0105, 0.0090, 0.0082, 0.0062],
        [0.0095, 0.0080, 0.0072, 0.0055],
    ]
)
"""(5, 4) thickness of the digits at their joints and tips, metres."""
ROOTS = np.array(
    [
        [-0.028, 0.030, 0.012],
        [0.046, 0.031, 0.0],
        [0.050, 0.010, -0.002],
        [0.046, -0.011, -0.001],
        [0.038, -0.030, 0.002],
    ]
)
"""(5, 3) first joints of the digits of a left hand, metres; a right hand has its thumb at -y."""
WRIST = np.array([-0.058, 0.0, 0.0])
"""Where the forearm begins, metres."""
GRIP_HEIGHT = 0.034
"""Height above the middle of the palm of the object between thumb and fingers, metres."""
WIDEST = 0.06
"""Largest span between thumb and fingers, metres."""
LARGE_M = 1.0
"""Objects of a larger diagonal are of PartNet's scale: the hand is scaled as if they measured `LIKE_M`."""
LIKE_M = 0.45
"""See `LARGE_M`."""
SHARE: tuple[float, float] = (0.08, 0.25)
"""Wanted range of the share of the object that a grip hides on average."""
WORST_SHARE = 0.35
"""Share of the object that a grip may hide in one frame without a cost."""
GOOD = 0.25
"""Largest cost (`_Planner._cost`) of a grip for a whole stretch; with a larger one the stretch is halved."""
DRAWS, MAX_DRAWS = 20, 40
"""Least and largest number of grips drawn for a stretch."""
SHORTEST = 28
"""Shortest duration of a grip, frames."""
REGRASP_FRAMES = 75
"""Mean duration of a grip, frames."""
WITHDRAWN = 0.08
"""Retraction of the hand between two grips, metres."""
SHIFT_FRAMES = 16
"""Duration of a change of grip, frames."""
BONES = 17
"""Rigid pieces: three of each digit, palm, forearm."""


@dataclass(frozen=True)
class Grasp:
    """A grip: pose of the hand and positions of the finger tips."""

    T_side_hand: Array
    """(4, 4) hand in the frame of the held side of the object."""
    tips: Array
    """(5, 3) tips of the digits in the hand's frame, metres."""
    withdrawn: float = 0.0
    """Retraction along the forearm, and by 0.7 times as much away from the camera, metres."""


@dataclass(frozen=True)
class Hand:
    """A hand: size, left or right, and textures."""

    scale: float
    """1 is 21 cm from wrist to finger tip."""
    thumb: float
    """+1 a left hand, -1 a right one."""
    skin: NDArray[np.uint8]
    """(h, w, 3) picture of the skin; v runs along the bones."""
    cloth: NDArray[np.uint8]
    """(h, w, 3) picture of the sleeve."""

    @property
    def mirror(self) -> Array:
        """(3,) factors that make a left hand's coordinates this hand's, metres."""
        return np.array([1.0, self.thumb, 1.0]) * self.scale

    def joints(self, tips: Array) -> Array:
        """(5, 4, 3) joints and tips of the digits that reach to `tips` (5, 3), in the hand's frame."""
        chains = []
        for k in range(5):
            bulge = np.array([0.0, 0.9 * self.thumb, 0.35]) if k == 0 else np.array([0.25, 0.0, -1.0])
            chains.append(_arc(ROOTS[k] * self.mirror, tips[k], LENGTHS[k] * self.scale, bulge))
        return np.stack(chains)

    def poses(self, T_camera_hand: Array, tips: Array, T_camera_arm: Array) -> Array:
        """(BONES, 4, 4) poses camera from piece."""
        chains = self.joints(tips)
        pieces = []
        for k, chain in enumerate(chains):
            back = np.array([0.0, 0.9 * self.thumb, -0.4]) if k == 0 else np.array([0.3, 0.0, -1.0])
            for a, b in itertools.pairwise(chain):
                pieces.append(T_camera_hand @ _pose_along(a, b, back))
        return np.stack([*pieces, T_camera_hand, T_camera_arm])

    def pieces(self, segments: int = 28) -> list[list[Skin]]:
        """Textured surfaces of every piece, in the order of `poses`."""
        s = self.scale
        pieces = []
        for k in range(5):
            for j in range(3):
                looks = [_skin(_rod(LENGTHS[k, j] * s, RADII[k, j] * s, RADII[k, j + 1] * s, segments), self.skin, s)]
                if j == 2:
                    looks.append(_skin(_nail(k, s, segments), _tint(self.skin, (1.06, 1.0, 1.02)), s, 0.35))
                pieces.append(looks)
        pieces.append([_skin(self._palm(segments), self.skin, s)])
        arm = _rod(0.13 * s, 0.0245 * s, 0.036 * s, segments, flat=0.8)
        sleeve = _rod(1.2 * s, 0.0455 * s, 0.075 * s, segments).translate([0, 0, 0.085 * s])
        pieces.append([_skin(arm, self.skin, s), _skin(sleeve, self.cloth, s, 0.95)])
        return pieces

    def _palm(self, segments: int) -> Manifold:
        """Knuckles, heel and the ball of the thumb."""
        m, s = self.mirror, self.scale

        def ball(at: tuple[float, float, float], radius: float) -> Manifold:
            return Manifold.sphere(radius * s, segments).translate((np.array(at) * m).tolist())

        knuckles = [ball(tuple(ROOTS[k] - [0.004, 0, 0]), RADII[k, 0] + 0.0012) for k in range(1, 5)]
        heel = [ball((-0.048, 0.014, 0.0), 0.0175), ball((-0.048, -0.014, 0.002), 0.0175)]
        thumb = [ball((-0.030, 0.024, 0.008), 0.017), ball((0.012, 0.030, 0.006), 0.012), heel[0]]
        edge = [ball((-0.02, -0.026, 0.006), 0.0155), heel[1], knuckles[3]]
        cushion = [ball((0.034, 0.020, 0.005), 0.011), ball((0.030, -0.022, 0.006), 0.011)]
        return (
            Manifold.batch_hull([*knuckles, *heel, *cushion]) + Manifold.batch_hull(thumb) + Manifold.batch_hull(edge)
        )

    def outlines(self) -> list[Mesh]:
        """Coarse meshes of all pieces, in the order of `poses`."""
        return [join_meshes([Mesh(look.vertices, look.faces) for look in looks]) for looks in self.pieces(10)]


def make_hand(diagonal: float, rng: np.random.Generator) -> Hand:
    """A hand for an object of bounding-box diagonal `diagonal`, metres."""
    scale = rng.uniform(0.81, 0.93) * (1.0 if diagonal <= LARGE_M else diagonal / LIKE_M)
    tone = rng.uniform(0.0, 1.0)
    light, dark = np.array([226, 184, 162.0]), np.array([108, 72, 54.0])
    cloth = rng.uniform(30, 200, 3)
    return Hand(
        float(scale),
        float(rng.choice([-1.0, 1.0])),
        _skin_picture(light + (dark - light) * tone, rng),
        _cloth_picture(cloth, rng),
    )


class HandMotion:
    """A hand that holds one side of the object during a planned motion; everything follows from the seed."""

    def __init__(self, plan: Plan, joint: Joint, meshes: tuple[Mesh, Mesh], camera: Camera, seed: int) -> None:
        rng = np.random.default_rng([seed, 6])
        self._plan, self._joint = plan, joint
        self.hand = make_hand(bounding_diagonal(*meshes), rng)
        planner = _Planner(self.hand, plan, joint, meshes, camera)
        self.held = planner.held
        """Side of the object that is held: 0 the parent side, 1 the child side."""
        n = len(plan.states)
        grips = max(1, round(n / REGRASP_FRAMES))
        inner = np.round((np.arange(1, grips) + rng.uniform(-0.2, 0.2, grips - 1)) * n / grips).astype(int)
        found = [planner.grips(range(a, b), rng) for a, b in itertools.pairwise([0, *inner, n])]
        self.grasps = [grasp for of_stretch in found for _, grasp in of_stretch]
        self._changes = np.array([start for of_stretch in found for start, _ in of_stretch][1:], float)

    def poses(self, t: float, T_camera_object: Array, state: float) -> Array:
        """(BONES, 4, 4) poses camera from piece at time `t`, in frames."""
        T_camera_side = T_camera_object if self.held == 0 else T_camera_object @ self._joint.transform(state)
        grasp = self.grasp(t)
        T_camera_hand = T_camera_side @ grasp.T_side_hand
        T_camera_arm = forearm(T_camera_hand, self.hand)
        away = T_camera_arm[:3, 2] + np.array([0, 0, 0.7])  # to behind the object
        for T in (T_camera_hand, T_camera_arm):
            T[:3, 3] += grasp.withdrawn * away
        return self.hand.poses(T_camera_hand, grasp.tips, T_camera_arm)

    def grasp(self, t: float) -> Grasp:
        """The grip at time `t`, in frames; between two grips the hand opens, retracts and closes again."""
        k = int(np.searchsorted(self._changes, t - SHIFT_FRAMES / 2))
        if k >= len(self._changes):
            return self.grasps[-1]
        u = float(np.clip((t - self._changes[k]) / SHIFT_FRAMES + 0.5, 0, 1))
        if u == 0:
            return self.grasps[k]
        return _interpolate_grasps(self.grasps[k], self.grasps[k + 1], u, self.hand.scale)


def forearm(T_camera_hand: Array, hand: Hand) -> Array:
    """The forearm's pose (4, 4): from the wrist, partly in line with the hand, mostly to the picture's lower border."""
    wrist = se3.transform(T_camera_hand, (WRIST * hand.scale)[None])[0]
    back = -T_camera_hand[:3, 0] * [1.0, 1.0, 0.4]  # the arm points neither to the camera nor away from it
    down = np.array([-0.3 * wrist[0] / max(wrist[2], 1e-6), 1.0, -0.15])
    way = 0.7 * back + down / np.linalg.norm(down)
    return _pose_along(wrist, wrist + way, T_camera_hand[:3, 1], T_camera_hand[:3, 2])


def _interpolate_grasps(a: Grasp, b: Grasp, u: float, scale: float) -> Grasp:
    """Interpolate two grips, u from 0 to 1; the hand is open and retracted in the middle."""
    s = u * u * u * (10 - 15 * u + 6 * u * u)
    away = np.sin(np.pi * s)
    turn = se3.log_so3(a.T_side_hand[:3, :3].T @ b.T_side_hand[:3, :3])
    R = a.T_side_hand[:3, :3] @ se3.exp_so3(s * turn)
    t = (1 - s) * a.T_side_hand[:3, 3] + s * b.T_side_hand[:3, 3]
    tips = (1 - s) * a.tips + s * b.tips
    open_tips = tips + scale * np.array([[0.01, 0.0, 0.02], *[[0.015, 0.0, -0.012]] * 4])
    return Grasp(se3.pose(R, t), tips + away * (open_tips - tips), WITHDRAWN * scale * away)


class _Planner:
    """Plans grips: draws some at the object's rim and takes the one of least cost."""

    def __init__(self, hand: Hand, plan: Plan, joint: Joint, meshes: tuple[Mesh, Mesh], camera: Camera) -> None:
        self._hand, self._plan, self._joint, self._meshes = hand, plan, joint, meshes
        self._caster = Caster(meshes)
        self._outlines = hand.outlines()
        self._diagonal = bounding_diagonal(*meshes)
        f = 72 / camera.width
        self._camera = Camera(np.diag([f, f, 1.0]) @ camera.K, 72, max(1, round(camera.height * f)))
        looks = [self._look(int(i)) for i in np.unique(np.linspace(0, len(plan.states) - 1, 12).astype(int))]
        seen = np.sum([[np.sum(side == 0), np.sum(side == 1)] for _, side in looks], 0)
        self.held = int(seen[1] > seen[0])
        self._one = Caster((meshes[self.held], meshes[self.held]))

    def grips(self, frames: range, rng: np.random.Generator) -> list[tuple[int, Grasp]]:
        """(first frame, grip) pairs for all of `frames`: one, or several where no grip is good throughout."""
        cost, grasp = self._best(frames, rng)
        if cost <= GOOD or len(frames) < 2 * SHORTEST:
            return [(frames[0], grasp)]
        half = len(frames) // 2
        return self.grips(frames[:half], rng) + self.grips(frames[half:], rng)

    def _best(self, frames: range, rng: np.random.Generator) -> tuple[float, Grasp]:
        """Cost and grip of the best of several random grips; more are drawn while none is good."""
        some = sorted({int(k) for k in np.linspace(frames[0], frames[-1], 9)})
        looks = {i: self._look(i) for i in some}
        best: tuple[float, Grasp] | None = None
        for draw in range(MAX_DRAWS):
            if draw >= DRAWS and best is not None and best[0] <= GOOD:
                break
            grasp = self._draw(int(rng.choice(some)), looks, rng)
            if grasp is None:
                continue
            cost = self._cost(grasp, looks)
            if best is None or cost < best[0]:
                best = cost, grasp
        return best if best is not None else (0.0, self._fallback(some[len(some) // 2]))

    def _Ts(self, i: int) -> tuple[Array, Array]:
        T = self._plan.Ts_camera_object[i]
        return T, T @ self._joint.transform(float(self._plan.states[i]))

    def _look(self, i: int) -> tuple[Array, NDArray[np.int64]]:
        """Depth (inf for none) and side (-1 for none) of the object in frame `i`."""
        hits = self._caster.look(self._camera, self._Ts(i))
        shape = self._camera.height, self._camera.width
        return hits.distance.reshape(shape), hits.side.reshape(shape)

    def _draw(
        self, i: int, looks: dict[int, tuple[Array, NDArray[np.int64]]], rng: np.random.Generator
    ) -> Grasp | None:
        """Draw a grip over a point of the held side's rim as seen in frame `i`."""
        depth, side = looks[i]
        body = (side >= 0).astype(np.uint8)
        rim = (side == self.held) & (cv2.erode(body, np.ones((3, 3), np.uint8)) == 0)
        if not rim.any():
            return None
        soft = cv2.GaussianBlur(body.astype(np.float32), (0, 0), 2.5)
        gradient = np.stack([cv2.Sobel(soft, cv2.CV_32F, 1, 0), cv2.Sobel(soft, cv2.CV_32F, 0, 1)], -1)
        v, u = rng.choice(np.argwhere(rim))
        inward = gradient[v, u] + 0.25 * rng.normal(size=2) * np.linalg.norm(gradient[v, u])
        inward = inward + np.array([0, -0.5]) * np.linalg.norm(inward)  # the arm comes from below
        if np.linalg.norm(inward) < 1e-9:
            return None
        d = np.array([*(inward / np.linalg.norm(inward)), 0.0])
        ray = self._camera.rays()[v, u]
        edge = ray * depth[v, u]
        view = ray / np.linalg.norm(ray)
        d = d - view * (d @ view)
        d /= np.linalg.norm(d)
        s = self._hand.scale
        overlap = float(rng.uniform(0.008, min(0.085, max(0.5 * self._diagonal / s, 0.016)))) * s
        T_side_camera = se3.inverse(self._Ts(i)[self.held])
        thickness = self._thickness(edge + d * min(overlap, 0.012 * s), view, T_side_camera)
        if thickness is None:
            return None
        near, far = thickness
        span = float(min(far - near, WIDEST * s))
        contact = edge + d * overlap
        contact = contact + view * (near - contact @ view)
        fingers_in_front = rng.random() < 0.6
        z = view if fingers_in_front else -view
        roll = se3.exp_so3(d * rng.normal(0, 0.25))
        R = roll @ np.stack([d, np.cross(z, d), z], 1)
        at = np.array([0.062 * s + overlap, 0.0, GRIP_HEIGHT * s - 0.5 * span])
        if not fingers_in_front:
            at = np.array([0.05 * s + overlap, 0.008 * self._hand.thumb * s, GRIP_HEIGHT * s + 0.5 * span])
        T_camera_hand = se3.pose(R, contact - R @ at)
        T_side_hand = T_side_camera @ T_camera_hand
        return Grasp(T_side_hand, self._contact_tips(T_side_hand, overlap, span))

    def _thickness(self, at: Array, view: Array, T_side_camera: Array) -> tuple[float, float] | None:
        """Distances along `view` at which the line through `at` enters and leaves the held side."""
        reach = 10 * float(np.linalg.norm(at))
        origins = np.stack([at - view * (at @ view), at + view * (reach - at @ view)])
        eye = np.eye(4)
        hits = self._one.cast(
            se3.transform(T_side_camera, origins), np.stack([view, -view]) @ T_side_camera[:3, :3].T, (eye, eye)
        )
        if not np.isfinite(hits.distance).all():
            return None
        return float(hits.distance[0]), float(reach - hits.distance[1])

    def _contact_tips(self, T_side_hand: Array, overlap: float, span: float) -> Array:
        """(5, 3) tips of the digits: on the surface where it is within reach, else curled."""
        s, m = self._hand.scale, self._hand.mirror
        height = GRIP_HEIGHT * s
        tips = np.empty((5, 3))
        reach = np.array([0.052, 0.062, 0.066, 0.061, 0.052]) * s + overlap
        most = ROOTS[:, 0] * s + 0.97 * LENGTHS.sum(1) * s
        tips[:, 0] = np.minimum(reach, most)
        tips[:, 1] = np.array([0.012, 0.026, 0.009, -0.009, -0.025]) * m[1]
        tips[:, 2] = height - 0.5 * span
        tips[0, 2] = height + 0.5 * span
        radius = RADII[:, 3] * s
        toward = np.array([-1.0, 1, 1, 1, 1])  # the thumb closes along -z, the fingers along +z
        start = tips - np.array([0, 0, 1]) * (toward * 0.06 * s)[:, None]
        hits = self._one.cast(
            se3.transform(T_side_hand, start), np.outer(toward, T_side_hand[:3, 2]), (np.eye(4), np.eye(4))
        )
        touched = hits.distance < 0.11 * s
        depth = start[:, 2] + toward * np.where(touched, hits.distance, 0)
        tips[:, 2] = np.where(touched, depth - toward * radius, tips[:, 2])
        curled = ~touched
        curled[0] = False
        tips[curled, 0] = ROOTS[curled, 0] * s + 0.018 * s
        tips[curled, 2] = 0.034 * s
        return tips

    def _cost(self, grasp: Grasp, looks: dict[int, tuple[Array, NDArray[np.int64]]]) -> float:
        """Cost of a grip: hidden shares, collisions, bend of the wrist, direction of the arm."""
        eye = np.eye(4)
        Ts = self._hand.poses(eye, grasp.tips, eye)[:-1]
        pieces = [mesh.moved(T) for T, mesh in zip(Ts, self._outlines[:-1], strict=True)]
        caster = Caster((join_meshes(pieces), self._outlines[-1]))
        shares, moving, bends, above, lows = [], [], [], [], []
        for i, (depth, side) in looks.items():
            T_camera_hand = self._Ts(i)[self.held] @ grasp.T_side_hand
            T_camera_arm = forearm(T_camera_hand, self._hand)
            hits = caster.look(self._camera, (T_camera_hand, T_camera_arm))
            front = hits.distance.reshape(depth.shape) < depth
            seen = side >= 0
            shares.append((front & seen).sum() / max(seen.sum(), 1))
            other = side == 1 - self.held
            moving.append((front & other).sum() / max(other.sum(), 1))
            bends.append(np.arccos(np.clip(-T_camera_hand[:3, 0] @ T_camera_arm[:3, 2], -1, 1)))
            above.append(max(0.3 - T_camera_arm[1, 2], 0.0))
            lows.append(T_camera_arm[2, 3] <= 0 or hits.distance.min() < 0.5 * depth.min())
        mean, low, high = float(np.mean(shares)), *SHARE
        cost = 6 * max(low + 0.03 - mean, 0) + 6 * max(mean - (high - 0.05), 0)
        cost += 3 * max(float(np.max(shares)) - WORST_SHARE, 0) + 0.8 * max(float(np.mean(moving)) - 0.3, 0)
        cost += 0.5 * float(np.mean(np.maximum(np.array(bends) - 0.8, 0))) + 0.5 * float(np.mean(above))
        cost += 2.0 * float(np.mean(lows))
        return cost + 0.5 * self._collision_share(grasp, list(looks))

    def _collision_share(self, grasp: Grasp, frames: list[int]) -> float:
        """Share of frames in which the hand collides with the other side of the object."""
        joints = self._hand.joints(grasp.tips).reshape(-1, 3)
        points = se3.transform(grasp.T_side_hand, np.concatenate([joints, (joints[0::4] + joints[1::4]) / 2]))
        mesh = self._meshes[1 - self.held]
        vertices = mesh.vertices[:: max(1, len(mesh.vertices) // 200)]
        hit = []
        for i in frames:
            Ts = self._Ts(i)
            there = se3.transform(se3.inverse(Ts[self.held]) @ Ts[1 - self.held], vertices)
            gap = cdist(there, points).min()
            hit.append(gap < 0.009 * self._hand.scale)
        return float(np.mean(hit))

    def _fallback(self, i: int) -> Grasp:
        """A grip below the object, for when no rim is visible."""
        Ts = self._Ts(i)
        vertices = se3.transform(Ts[self.held], self._meshes[self.held].vertices)
        low = vertices[vertices[:, 1].argmax()]
        R = np.stack([[0.0, -1, 0], [-1.0, 0, 0], [0.0, 0, -1]], 1)
        T_side_hand = se3.inverse(Ts[self.held]) @ se3.pose(R, low - R @ np.array([0.07, 0, 0.03]) * self._hand.scale)
        return Grasp(T_side_hand, self._contact_tips(T_side_hand, 0.01 * self._hand.scale, 0.02 * self._hand.scale))


def _arc(root: Array, tip: Array, lengths: Array, bulge: Array) -> Array:
    """(4, 3) joints of three bones from `root` to `tip`, bent towards `bulge`; straight when out of reach."""
    chord = tip - root
    distance = float(np.linalg.norm(chord))
    way = chord / max(distance, 1e-9)
    side = bulge - way * (bulge @ way)
    side /= max(float(np.linalg.norm(side)), 1e-9)

    flat = _bend_bones(lengths, distance)
    return root + flat[:, :1] * way + flat[:, 1:] * side


@numba.njit(cache=True)
def _bend_bones(lengths: Array, distance: float) -> Array:
    """(4, 2) joints of three bones in a plane, from the origin to a tip on the x axis at `distance`, or straight."""
    flat = np.zeros((4, 2))
    low, high = 0.0, 1.9
    for _ in range(26):
        bend = (low + high) / 2
        for k in range(3):
            angle = -bend * (0.0, 1.0, 1.7)[k]
            flat[k + 1, 0] = flat[k, 0] + lengths[k] * np.cos(angle)
            flat[k + 1, 1] = flat[k, 1] + lengths[k] * np.sin(angle)
        if flat[3, 0] ** 2 + flat[3, 1] ** 2 > distance**2:
            low = bend
        else:
            high = bend
    angle = np.arctan2(flat[3, 1], flat[3, 0])
    turned = np.empty_like(flat)
    turned[:, 0] = flat[:, 0] * np.cos(angle) + flat[:, 1] * np.sin(angle)
    turned[:, 1] = flat[:, 1] * np.cos(angle) - flat[:, 0] * np.sin(angle)
    return turned


def _pose_along(a: Array, b: Array, back: Array, spare: Array | None = None) -> Array:
    """The pose (4, 4) at `a` with z towards `b` and x as near as possible to `back`."""
    z = (b - a) / max(float(np.linalg.norm(b - a)), 1e-12)
    x = back - z * (back @ z)
    if np.linalg.norm(x) < 1e-3:
        other = np.array([1.0, 0, 0]) if spare is None else spare
        x = other - z * (other @ z)
    x /= np.linalg.norm(x)
    return se3.pose(np.stack([x, np.cross(z, x), z], 1), a)


def _rod(length: float, start: float, end: float, segments: int, flat: float = 1.0) -> Manifold:
    """A rod with round ends from the origin along z, its radii given; `flat` narrows its start along x."""
    first = Manifold.sphere(start, segments).scale([flat, 1.0, 1.0])
    return Manifold.batch_hull([first, Manifold.sphere(end, segments).translate([0, 0, length])])


def _nail(digit: int, scale: float, segments: int) -> Manifold:
    """The nail of a digit, in the frame of its last bone (x is the back of the finger)."""
    radius, length = RADII[digit, 3] * scale, LENGTHS[digit, 2] * scale
    nail = Manifold.sphere(1.0, segments).scale([0.22 * radius, 0.72 * radius, 1.0 * radius])
    return nail.translate([0.93 * radius, 0, length])


def _skin(solid: Manifold, picture: NDArray[np.uint8], scale: float, roughness: float = 0.55) -> Skin:
    """A smooth surface with a texture along z, repeated every 8 cm."""
    vertices, faces = triangles(solid)
    normals = np.zeros_like(vertices)
    np.add.at(normals, faces, triangle_normals(vertices, faces)[:, None])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    uv = np.stack([vertices[:, 1] + 0.31 * vertices[:, 0], vertices[:, 2] + 0.47 * vertices[:, 0]], 1) / (0.08 * scale)
    return Skin(vertices, faces, normals, uv, picture, roughness)


def _tint(picture: NDArray[np.uint8], factors: tuple[float, float, float]) -> NDArray[np.uint8]:
    return np.asarray(np.clip(picture.astype(float) * np.array(factors) * 1.06, 0, 255).astype(np.uint8))


def _skin_picture(colour: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Skin: blotches, fine lines and pores on an sRGB colour (3,), 0 to 255."""
    size = 256
    blotch = cv2.GaussianBlur(rng.normal(size=(size, size)), (0, 0), 14, borderType=cv2.BORDER_REFLECT)
    lines = cv2.GaussianBlur(rng.normal(size=(size, size)), (0, 0), 3.5, sigmaY=1.0, borderType=cv2.BORDER_REFLECT)
    pores = cv2.GaussianBlur(rng.normal(size=(size, size)), (0, 0), 0.9)
    shade = 1 + 0.035 * blotch / blotch.std() + 0.018 * lines / lines.std() + 0.02 * pores / pores.std()
    red = 1 + 0.03 * blotch / blotch.std()
    picture = colour * shade[..., None]
    picture[..., 0] *= red
    return np.asarray(np.clip(picture, 0, 255).astype(np.uint8))


def _cloth_picture(colour: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Knitted cloth of an sRGB colour (3,), 0 to 255."""
    v, u = np.mgrid[0:256, 0:256] / 256
    rib = 0.88 + 0.12 * np.cos(2 * np.pi * 24 * u) * (0.6 + 0.4 * np.cos(2 * np.pi * 40 * v))
    grain = 1 + 0.05 * rng.normal(size=(256, 256))
    return np.asarray(np.clip(colour * (rib * grain)[..., None], 0, 255).astype(np.uint8))
