"""Reference answers made from the truth, which check the scoring of a data folder.

The truth itself must score perfectly, a static object and random numbers badly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

import freeart21
from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.benchmark import read_benchmark
from freeart21.files.result import Method, write_method, write_result
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Reconstruction
from freeart21.truth import Truth

Kind = Literal["truth", "static", "random"]
KINDS: tuple[Kind, ...] = get_args(Kind)
_CODE = "reference row made from the truth"


def write_reference(kind: Kind, data: Path, out: Path, seed: int = 0, sequences: Sequence[str] | None = None) -> None:
    """Write the results folder `out` of reference answers to `data`, without assets.

    'truth' is the truth, held-out views included. 'static' is the object of frame 0 as one rigid body at rest, with a
    joint that does not move. 'random' draws poses, joint, states, masks and boxes from `seed`. Equal arguments give
    equal bytes. `sequences` limits it to some of the data folder's sequences.

    Raises FreeArtError when `kind` or a sequence is unknown, `out` exists, or the data folder is broken.
    """
    if kind not in KINDS:
        raise FreeArtError(f"unknown reference row '{kind}'; reference rows: {', '.join(KINDS)}")
    benchmark = read_benchmark(data)
    settings = {"kind": kind, **({"seed": seed} if kind == "random" else {})}
    with atomic.new_folder(Path(out)) as staging:
        code = f"freeart21 {freeart21.__version__}, {_CODE}"
        write_method(staging, Method(Path(out).resolve().name, code, settings))
        for name in benchmark.select_sequences(sequences):
            truth = read_truth(benchmark.truth(name))
            rng = np.random.default_rng([seed, *name.encode()])
            answer = {"truth": truth_answer, "static": static_answer, "random": random_answer}[kind](truth, rng)
            views = range(len(read_sequence(benchmark.sequence(name)).queries)) if kind == "truth" else ()
            write_result(staging / name, answer, settings, [_on_white(truth, i) for i in views] or None)


def _on_white(truth: Truth, query: int) -> NDArray[np.uint8]:
    """(height, width, 3) a held-out view of the truth, white around the object."""
    return np.where(truth.query_mask(query)[..., None], truth.query_rgb(query), np.uint8(255)).astype(np.uint8)


def is_reference(method: Method) -> bool:
    """Whether its answers are made from the truth: it has points, and no place among methods."""
    return method.code.endswith(_CODE)


def is_outside_ranking(method: Method) -> bool:
    """Whether it has points and no place: a reference row, or one that was given a part of the truth (`run`)."""
    return is_reference(method) or bool((method.settings or {}).get("privileged_inputs"))


def truth_answer(truth: Truth, rng: np.random.Generator | None = None) -> Reconstruction:
    """The truth as an answer."""
    return Reconstruction(
        truth.articulation,
        truth.states,
        truth.Ts_camera_reference,
        truth.Ts_camera_moving,
        _masks(truth),
        truth.seen > 0,
    )


def static_answer(truth: Truth, rng: np.random.Generator | None = None) -> Reconstruction:
    """The object of frame 0 at rest, labelled as one part, with a revolute joint at state zero."""
    answer, n = truth_answer(truth), len(truth)
    still = np.repeat(truth.Ts_camera_reference[:1], n, 0)
    parts = truth.articulation
    moving = parts.moving.moved(parts.joint.transform(truth.states[0]))
    joint = Joint("none", "revolute", np.array([0.0, 0.0, 1.0]), np.zeros(3), 0.0, 1.0)
    return replace(
        answer,
        articulation=Articulation(joint, parts.reference, moving),
        states=np.zeros(n),
        Ts_camera_reference=still,
        Ts_camera_moving=still,
        part_masks=(answer.part_masks > 0).astype(np.uint8),
        seen=np.repeat([[True, False]], n, 0),
    )


def random_answer(truth: Truth, rng: np.random.Generator) -> Reconstruction:
    """Random joint, poses, states, masks and two boxes, of the true object's size and place."""
    answer, n, size = truth_answer(truth), len(truth), truth.diagonal
    axis = _directions(rng, 1)[0]
    limit = float(np.pi if rng.random() < 0.5 else size)
    kind: Literal["revolute", "prismatic"] = "revolute" if limit == np.pi else "prismatic"
    joint = Joint("any", kind, axis, rng.normal(size=3) * size if kind == "revolute" else np.zeros(3), -limit, limit)
    place = truth.Ts_camera_reference[0, :3, 3]
    Ts = [
        se3.pose(
            se3.exp_so3(_directions(rng, n) * rng.uniform(0, np.pi, (n, 1))),
            place + 0.5 * size * rng.normal(size=(n, 3)),
        )
        for _ in range(2)
    ]
    masks = np.where(answer.part_masks > 0, rng.integers(0, 3, answer.part_masks.shape), 0).astype(np.uint8)
    return replace(
        answer,
        articulation=Articulation(joint, _box(rng, size), _box(rng, size)),
        states=rng.uniform(-limit, limit, n),
        Ts_camera_reference=Ts[0],
        Ts_camera_moving=Ts[1],
        part_masks=masks,
    )


def _masks(truth: Truth) -> NDArray[np.uint8]:
    return np.stack([truth.part_mask(i) for i in range(len(truth))])


def _directions(rng: np.random.Generator, n: int) -> NDArray[Any]:
    """(n, 3) unit vectors, uniform over the sphere."""
    v = rng.normal(size=(n, 3))
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def _box(rng: np.random.Generator, size: float) -> Mesh:
    """A random box near the origin, `size` in metres."""
    corners = (np.array(list(np.ndindex(2, 2, 2))) - 0.5) * rng.uniform(0.1, 0.6, 3) * size
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    return Mesh(corners + rng.uniform(-0.5, 0.5, 3) * size, faces)
