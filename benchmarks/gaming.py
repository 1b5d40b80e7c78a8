"""Dishonest answers that must all score worse than the honest one they are made from.

    .venv/bin/python -m benchmarks.gaming --data data/demo

makes an honest answer to each sequence (the truth, a little wrong everywhere), cheats with it in each way of `CHEATS`,
and scores all of them by the protocols of --protocols in points (`leaderboard.points`). A protocol is frozen only when
no cheat gains anything in the track that it aims at, or on the whole. Add a cheat: a function of an `Answer` in
`CHEATS`, with the track it aims at. Prints the table and writes benchmarks/results/gaming.json.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from benchmarks.common import RESULTS, print_table, run_cli, write_report
from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.files.benchmark import read_benchmark
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.mesh import Mesh
from freeart21.reconstruction import Reconstruction
from freeart21.truth import Truth
from leaderboard.points import row_points
from leaderboard.protocol import Case, Protocol, Shape
from leaderboard.protocols import protocol_named
from leaderboard.rows import Row

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Answer:
    """What a cheat starts from."""

    truth: Truth
    given: Reconstruction
    renders: tuple[Image, ...]
    frames: tuple[Image, ...]
    """Some pictures of the video, object on white."""
    seed: int

    def case(self) -> Case:
        """As a protocol measures it: the asset says what the files say."""
        parts = self.given.articulation
        motions = np.stack([parts.joint.transform(q) for q in self.given.states])
        return Case(self.truth, self.given, self.renders, Shape((parts.reference, parts.moving), motions))

    def with_parts(self, change: Callable[[Mesh], Mesh]) -> Answer:
        """Both part meshes changed."""
        parts = self.given.articulation
        changed = Articulation(parts.joint, change(parts.reference), change(parts.moving))
        return replace(self, given=replace(self.given, articulation=changed))

    def with_views(self, change: Callable[[Image], Image]) -> Answer:
        """All renders changed."""
        return replace(self, renders=tuple(change(render) for render in self.renders))

    @property
    def rng(self) -> np.random.Generator:
        """Random numbers that depend on the seed only."""
        return np.random.default_rng([self.seed, 49])


def make_honest(truth: Truth, frames: tuple[Image, ...] = (), views: int = 2, seed: int = 0) -> Answer:
    """The truth with everything a little wrong, about as much as a good method of today."""
    rng, joint = np.random.default_rng([seed, 21]), truth.articulation.joint
    diagonal = truth.diagonal
    twist = np.concatenate([rng.normal(size=3) * 0.001 * diagonal, rng.normal(size=3) * np.deg2rad(0.3)])
    parts = [
        replace(part, vertices=part.vertices + rng.normal(size=part.vertices.shape) * 0.002 * diagonal)
        for part in (truth.articulation.reference, truth.articulation.moving)
    ]
    off = [
        se3.exp_se3(rng.normal(size=(len(truth), 6)) * ([0.001 * diagonal] * 3 + [np.deg2rad(0.3)] * 3)) for _ in (0, 1)
    ]
    masks = np.stack([truth.part_mask(i) for i in range(len(truth))])
    masks = np.stack([np.where(cv2.erode(m, np.ones((3, 3), np.uint8)) > 0, m, 0) for m in masks]).astype(np.uint8)
    given = Reconstruction(
        Articulation(joint.moved(se3.exp_se3(twist)), *parts),
        truth.states + rng.normal(size=len(truth)) * 0.005 * truth.range_of_motion,
        truth.Ts_camera_reference @ off[0],
        truth.Ts_camera_moving @ off[1],
        masks,
        np.ones((len(truth), 2), bool),
    )
    return Answer(truth, given, tuple(_blurred_view(truth, i, rng) for i in range(views)), frames, seed)


def _blurred_view(truth: Truth, query: int, rng: np.random.Generator) -> Image:
    """A held-out view, blurred and noisy, its background white."""
    mask = truth.query_mask(query)
    picture = np.where(mask[..., None], truth.query_rgb(query), np.uint8(255))
    picture = cv2.GaussianBlur(picture, (3, 3), 0.8).astype(float) + rng.normal(size=picture.shape) * 6
    grown = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return np.where(grown[..., None], np.clip(picture, 0, 255), 255).astype(np.uint8)


# ---- surfaces


def _sample(mesh: Mesh, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 3) points, uniform over the area."""
    areas = mesh.areas()
    chosen = mesh.vertices[mesh.faces[rng.choice(len(areas), count, p=areas / areas.sum())]]
    weights = rng.dirichlet(np.ones(3), count)
    return np.einsum("nk,nkj->nj", weights, chosen)


def _specks(mesh: Mesh, count: int, size: float, rng: np.random.Generator) -> Mesh:
    """So many triangles of this size, metres, on the surface."""
    corners = _sample(mesh, count, rng)[:, None] + rng.normal(size=(count, 3, 3)) * size
    return Mesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


def _joined(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def _scaled(mesh: Mesh, factor: float) -> Mesh:
    centre = mesh.vertices.mean(0)
    return Mesh(centre + factor * (mesh.vertices - centre), mesh.faces)


def _hull(mesh: Mesh) -> Mesh:
    hull = ConvexHull(mesh.vertices)
    return Mesh(mesh.vertices, hull.simplices)


def _box(mesh: Mesh) -> Mesh:
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    return _hull(Mesh(low + corners * (high - low), np.zeros((0, 3), int)))


def dust(a: Answer) -> Answer:
    """20,000 triangles of a micrometre on each surface."""
    return a.with_parts(lambda mesh: _specks(mesh, 20_000, 1e-6, a.rng))


def scales(a: Answer) -> Answer:
    """5,000 triangles of half a per cent of the object on each surface: about the right area, in all directions."""
    return a.with_parts(lambda mesh: _specks(mesh, 5_000, 0.005 * a.truth.diagonal, a.rng))


def crowd(a: Answer) -> Answer:
    """The parts' boxes, and the fifth of the surface that lies nearest to its first point 50 times, for the samples."""

    def change(mesh: Mesh) -> Mesh:
        off = np.linalg.norm(mesh.vertices[mesh.faces].mean(1) - mesh.vertices[0], axis=1)
        patch = mesh.with_faces(off <= np.quantile(off, 0.2))
        return _joined(_box(mesh), *[patch] * 50)

    return a.with_parts(change)


def shells(a: Answer) -> Answer:
    """The surface three times, each within the other."""
    return a.with_parts(lambda mesh: _joined(mesh, _scaled(mesh, 0.96), _scaled(mesh, 0.92)))


def doubled(a: Answer) -> Answer:
    """Every face twice."""
    return a.with_parts(lambda mesh: _joined(mesh, mesh))


def hull(a: Answer) -> Answer:
    """The parts' convex hulls, 2 % larger."""
    return a.with_parts(lambda mesh: _scaled(_hull(mesh), 1.02))


def boxes(a: Answer) -> Answer:
    """The parts' bounding boxes."""
    return a.with_parts(_box)


def straddling(a: Answer) -> Answer:
    """Two surfaces, one per cent of the object to either side of the true one."""
    shift = 0.01 * a.truth.diagonal * np.array([0.6, 0.6, 0.53])
    return a.with_parts(lambda m: _joined(*(Mesh(m.vertices + sign * shift, m.faces) for sign in (1, -1))))


def slivers(a: Answer) -> Answer:
    """20,000 needles through the surface of each part, added to it."""

    def change(mesh: Mesh) -> Mesh:
        ends = _sample(mesh, 20_000, a.rng)
        along = a.rng.normal(size=ends.shape) * 0.02 * a.truth.diagonal
        corners = np.stack([ends, ends + along, ends + along + 1e-7], 1)
        return _joined(mesh, Mesh(corners.reshape(-1, 3), np.arange(60_000).reshape(-1, 3)))

    return a.with_parts(change)


def mist(a: Answer) -> Answer:
    """20,000 specks of a micrometre within 1 % about the surface, added to it."""

    def change(mesh: Mesh) -> Mesh:
        specks = _specks(mesh, 20_000, 1e-6, a.rng)
        off = np.repeat(a.rng.normal(size=(20_000, 3)) * 0.005 * a.truth.diagonal, 3, axis=0)
        return _joined(mesh, Mesh(specks.vertices + off, specks.faces))

    return a.with_parts(change)


def decoy(a: Answer) -> Answer:
    """The mist, and a speck a million sizes away, in case something counts from the smallest corner."""

    def change(mesh: Mesh) -> Mesh:
        far = _specks(mesh, 1, 1e-6, a.rng)
        return _joined(mesh, Mesh(far.vertices - 1e6 * a.truth.diagonal, far.faces))

    return mist(a).with_parts(change)


def fog(a: Answer) -> Answer:
    """The same of 20,000 specks that are large enough to count."""

    def change(mesh: Mesh) -> Mesh:
        specks = _specks(mesh, 20_000, 0.002 * a.truth.diagonal, a.rng)
        off = np.repeat(a.rng.normal(size=(20_000, 3)) * 0.004 * a.truth.diagonal, 3, axis=0)
        return _joined(mesh, Mesh(specks.vertices + off, specks.faces))

    return a.with_parts(change)


def half(a: Answer) -> Answer:
    """Only the half of each surface that is nearer its middle."""

    def change(mesh: Mesh) -> Mesh:
        off = np.linalg.norm(mesh.vertices[mesh.faces].mean(1) - mesh.vertices.mean(0), axis=1)
        return mesh.with_faces(off <= np.median(off))

    return a.with_parts(change)


def displaced(a: Answer) -> Answer:
    """The truth's own meshes, 1 % of the object off."""
    parts, joint = a.truth.articulation, a.given.articulation.joint
    shift = 0.01 * a.truth.diagonal * np.array([0.6, 0.6, 0.53])
    moved = [Mesh(mesh.vertices + shift, mesh.faces) for mesh in (parts.reference, parts.moving)]
    return replace(a, given=replace(a.given, articulation=Articulation(joint, *moved)))


def curtain(a: Answer) -> Answer:
    """A plane of ten object sizes through the object's middle, added to the surface."""

    def change(mesh: Mesh) -> Mesh:
        size, centre = 5 * a.truth.diagonal, mesh.vertices.mean(0)
        corners = centre + size * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        return _joined(mesh, Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]])))

    return a.with_parts(change)


def exchanged(a: Answer) -> Answer:
    """Each part's mesh under the other's name, everything else as it was."""
    parts = a.given.articulation
    return replace(a, given=replace(a.given, articulation=Articulation(parts.joint, parts.moving, parts.reference)))


def one_part(a: Answer) -> Answer:
    """The whole object as the reference part, a speck as the moving one."""
    parts = a.given.articulation
    every = _joined(parts.reference, parts.moving.moved(parts.joint.transform(a.given.states[0])))
    speck = _specks(parts.moving, 1, 1e-3, a.rng)
    masks = (a.given.part_masks > 0).astype(np.uint8)
    return replace(a, given=replace(a.given, articulation=Articulation(parts.joint, every, speck), part_masks=masks))


# ---- joint and motion


def wrong_joint(a: Answer) -> Answer:
    """Right poses and masks, an axis across the true one."""
    parts = a.given.articulation
    side = np.cross(parts.joint.axis, np.eye(3)[int(np.argmin(np.abs(parts.joint.axis)))])
    joint = replace(parts.joint, axis=side / np.linalg.norm(side))
    return replace(a, given=replace(a.given, articulation=Articulation(joint, parts.reference, parts.moving)))


def still(a: Answer) -> Answer:
    """Right poses of the reference part, and a joint that never moves."""
    given = a.given
    still = given.Ts_camera_reference @ given.articulation.joint.transform(given.states.mean())
    return replace(
        a, given=replace(given, states=np.full_like(given.states, given.states.mean()), Ts_camera_moving=still)
    )


def far_pivot(a: Answer) -> Answer:
    """The other type of joint: a slider as a hinge a hundred sizes away, a hinge as a slider across its axis."""
    parts, given = a.given.articulation, a.given
    far = 100 * a.truth.diagonal
    side = np.cross(parts.joint.axis, np.eye(3)[int(np.argmin(np.abs(parts.joint.axis)))])
    side /= np.linalg.norm(side)
    if parts.joint.type == "prismatic":
        away = np.cross(parts.joint.axis, side)
        joint = replace(parts.joint, type="revolute", axis=side, pivot=parts.moving.vertices.mean(0) + far * away)
        joint, states = replace(joint, lower=-np.pi, upper=np.pi), given.states / far
    else:
        arm = float(np.linalg.norm(np.cross(parts.moving.vertices.mean(0) - parts.joint.pivot, parts.joint.axis)))
        joint, states = replace(parts.joint, type="prismatic", axis=side, lower=-10.0, upper=10.0), given.states * arm
    changed = Articulation(joint, parts.reference, parts.moving)
    return replace(a, given=replace(given, articulation=changed, states=states))


def two_states(a: Answer) -> Answer:
    """Open or closed, nothing between."""
    states = a.given.states
    return replace(a, given=replace(a.given, states=np.where(states > np.median(states), states.max(), states.min())))


def whole_mask(a: Answer) -> Answer:
    """All pixels are of the larger part."""
    larger = 1 + int((a.given.part_masks == 2).sum() > (a.given.part_masks == 1).sum())
    return replace(a, given=replace(a.given, part_masks=np.where(a.given.part_masks > 0, larger, 0).astype(np.uint8)))


# ---- views


def _on_background(a: Answer, background: Callable[[Image], Image]) -> Answer:
    """Right inside the true masks, something else around them."""
    masks = [a.truth.query_mask(i) for i in range(len(a.renders))]
    views = zip(a.renders, masks, strict=True)
    return replace(a, renders=tuple(np.where(m[..., None], r, background(r)).astype(np.uint8) for r, m in views))


def noise_around(a: Answer) -> Answer:
    """Noise outside the silhouette."""
    return _on_background(a, lambda render: a.rng.integers(0, 256, render.shape).astype(np.uint8))


def flooded(a: Answer) -> Answer:
    """The mean colour of the object outside the silhouette."""
    return _on_background(a, lambda r: np.broadcast_to(r[(r < 250).any(-1)].mean(0).astype(np.uint8), r.shape))


def grey(a: Answer) -> Answer:
    """A grey background."""
    return _on_background(a, lambda render: np.full_like(render, 200))


def blank(a: Answer) -> Answer:
    """White pictures."""
    return a.with_views(lambda render: np.full_like(render, 255))


def mean_colour(a: Answer) -> Answer:
    """The right silhouette in one colour."""
    return _flat(a, lambda render, inside: render[inside].mean(0))


def _flat(a: Answer, colour: Callable[[Image, NDArray[np.bool_]], np.ndarray]) -> Answer:
    def change(render: Image) -> Image:
        inside = (render < 250).any(-1)
        out = render.copy()
        out[inside] = colour(render, inside) if inside.any() else 0
        return out

    return a.with_views(change)


def smooth(a: Answer) -> Answer:
    """Views blurred until no texture is left."""
    return a.with_views(lambda render: np.asarray(cv2.GaussianBlur(render, (0, 0), 8.0)))


def nearest_frame(a: Answer) -> Answer:
    """The frame of the video that comes nearest to each view, instead of a render."""

    def change(render: Image) -> Image:
        frames = [f for f in a.frames if f.shape == render.shape]
        return min(
            frames, key=lambda f: float(np.mean((f.astype(float) - render) ** 2)), default=np.full_like(render, 255)
        )

    return a.with_views(change)


CHEATS: dict[str, tuple[Callable[[Answer], Answer], str]] = {
    f.__name__.strip("_"): (f, track)
    for track, functions in {
        "geometry": (dust, scales, crowd, shells, doubled, hull, boxes, straddling, slivers, mist, decoy, fog, half,
                     displaced, curtain, exchanged, one_part),
        "joint": (wrong_joint, still, far_pivot, two_states),
        "whole": (whole_mask,),
        "views": (noise_around, flooded, grey, blank, mean_colour, smooth, nearest_frame),
    }.items()
    for f in functions
}  # fmt: skip
"""Name to the cheat and the track that it aims at."""


NOTHING = 0.1
"""Points: a cheat that gains less gains nothing: other samples of one surface change as much."""


def score(answer: Answer, rules: Protocol, track: str) -> float:
    """Points, 0 to 100, of an answer in a track."""
    truth, found = answer.truth, rules.measure(answer.case())
    kind, penalties = truth.articulation.joint.type, rules.penalties(truth)
    values: dict[str, float | None] = {}
    for id, penalty in penalties.items():
        value = found.values.get(id, penalty)
        values[id] = None if penalty is None or value is None else rules.capped_value(id, value, penalty)
    row = Row("", kind, "ok", "", "asset", found.swapped, truth.diagonal, values, {})
    return row_points(row, track, rules) or 0.0


def main(
    data: Path,
    protocols: tuple[str, ...] = ("strict-2", "strict-3"),
    seed: int = 0,
    out: Path = RESULTS / "gaming.json",
) -> int:
    """Score all cheats.

    Args:
        data: A data folder with its truth.
        protocols: To score by.
        seed: Of the honest answers and the cheats.
        out: The JSON file.

    Returns 1 where the last protocol lets a cheat win.
    """
    benchmark = read_benchmark(data)
    rows = []
    for name in benchmark.sequences:
        recording, truth = read_sequence(benchmark.sequence(name)), read_truth(benchmark.truth(name))
        steps = range(0, len(recording), max(1, len(recording) // 20))
        shots = (recording.frame(i) for i in steps)
        frames = tuple(np.where(shot.mask[..., None], shot.rgb, 255).astype(np.uint8) for shot in shots)
        honest = make_honest(truth, frames, len(recording.queries), seed)
        rules = [protocol_named(protocol) for protocol in protocols]
        base = {(p.name, t): score(honest, p, t) for p in rules for t in ("whole", "joint", "geometry", "views")}
        for cheat, (change, track) in CHEATS.items():
            answer, gains = change(honest), {}
            for p in rules:
                gains[p.name] = {t: score(answer, p, t) - base[p.name, t] for t in {track, "whole"}}
            rows.append({"sequence": name, "cheat": cheat, "aims at": track, "gain": gains})
            print(f"{name} {cheat}: {gains}", flush=True)
    worst = {
        (cheat, p): max(max(r["gain"][p].values()) for r in rows if r["cheat"] == cheat)
        for cheat in CHEATS
        for p in protocols
    }
    order = sorted(CHEATS, key=lambda cheat: -worst[cheat, protocols[-1]])
    lines = [
        [c, CHEATS[c][1], (CHEATS[c][0].__doc__ or "").strip(), *(f"{worst[c, p]:+.1f}" for p in protocols)]
        for c in order
    ]
    print_table("points gained by cheating, largest of all sequences", ["cheat", "aims at", "what", *protocols], lines)
    wins = {p: [c for c in order if worst[c, p] >= NOTHING] for p in protocols}
    write_report(out, {"protocols": protocols, "seed": seed, "cheats": len(CHEATS)}, wins=wins, rows=rows)
    for protocol, cheats in wins.items():
        print(f"{protocol}: {len(cheats)} of {len(CHEATS)} cheats gain: {', '.join(cheats) or '-'}")
    return int(bool(wins[protocols[-1]]))


if __name__ == "__main__":
    run_cli(main)
