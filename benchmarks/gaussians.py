"""How fast Gaussians are drawn and pulled: milliseconds an iteration against their count, and against the memory.

    .venv/bin/python -m benchmarks.gaussians [--counts 5000 20000] [--windows 240x240] [--backend numba]

prints a table and writes benchmarks/results/gaussians.json (commit, machine, settings, summary, a row a count and
window).

- *scene*: a box with a lid, each under its own motion, covered by discs, each with its share of the surface. It
  covers 32,000 pixels in every window (with another `--focal` others), as objects do in a video of 640 x 360.
- *forward* draws, *backward* takes derivatives by colour, depth and alpha back to all parameters and both poses.
  Medians of `repeats`, in turns over all rows, after one that is left out.
- *limit*: what must be moved even if nothing else took time, each byte once. Forward: 57 bytes of a Gaussian read
  (means, quaternions, scales, opacity, colour, motion), 24 of a pixel written (colour, depth, alpha, moving). Backward:
  24 of a pixel read (the derivatives, and the transmittance that is left), 57 of a Gaussian read again and 61 of its
  derivatives written (those numbers, the screen's, and `drawn`). Divided by the bandwidth that copying large arrays
  reaches with the same threads, measured between the repeats; a copied byte counts twice, read and written. *share* is
  limit over measured: 1 would be a rasteriser that only waits for memory.
- *step*: a whole step of the optimisation of as many Gaussians: those that face the camera are drawn, held to a picture
  of others by all losses, and stepped. A round is a step a frame, and 150 at least.
- *pairs*: pixels in Gaussians' ellipses, hidden ones included: what the work grows with.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from rich.console import Console

from benchmarks.common import RESULTS, make_table, run_cli, write_report
from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.gaussians import multiply
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from reconstruct.gaussians import backends
from reconstruct.gaussians.adam import Adam
from reconstruct.gaussians.model import Parameters, logit
from reconstruct.gaussians.optimisation import Fit
from reconstruct.gaussians.rasteriser import DILATION, FAINTEST, Lens, Rasterise, Splats
from reconstruct.gaussians.windows import Window, Windows
from reconstruct.kernels import run_in_threads
from reconstruct.poses import JointedPoses
from reconstruct.settings import GaussianSettings

READ, WRITTEN, DRAWN, PULLED = 57, 61, 24, 24
"""Bytes: of a Gaussian, of its derivatives, of a pixel drawn, and of a pixel pulled."""
SIZE = (0.24, 0.16, 0.10)
"""Of the object, metres."""
DISTANCE = 0.5
"""Of the object, metres."""
HINGE, OPEN = Joint("lid", "revolute", [1, 0, 0], [0, -0.2 * SIZE[1], 0.5 * SIZE[2]], -np.inf, np.inf), 0.2
"""Of the lid, and its state, rad."""
COPIED = 256 << 20
"""Bytes of the array that is copied: more than a processor keeps."""


@dataclass(frozen=True)
class Scene:
    """What is drawn again and again."""

    splats: Splats
    poses: np.ndarray
    lens: Lens
    given: list[np.ndarray]
    """Derivatives by colour, depth and alpha."""


@dataclass(frozen=True)
class Taken:
    """Seconds, a number a repeat."""

    forward: list[float]
    backward: list[float]
    step: list[float]


def main(
    counts: tuple[int, ...] = (5_000, 10_000, 20_000, 50_000, 100_000),
    windows: tuple[str, ...] = ("240x240", "640x360"),
    backend: backends.Name = "numba",
    focal: float = 400.0,
    repeats: int = 9,
    seed: int = 0,
    out: Path = RESULTS / "gaussians.json",
) -> None:
    """Measure a rasteriser of Gaussians.

    Args:
        counts: Gaussians.
        windows: WIDTHxHEIGHT, pixels.
        backend: auto, numba, or gsplat.
        focal: Of the camera, pixels: how large the object is in the picture.
        repeats: Measurements of each.
        seed: Of the discs.
        out: The JSON file.
    """
    rasterise = backends.choose_backend(backend)
    name = rasterise.__module__.rsplit(".", 1)[-1].removesuffix("_backend")
    scenes = {(n, window): _scene(n, *_size(window), focal, seed) for window in windows for n in counts}
    bandwidth, taken = _measure(rasterise, scenes, focal, repeats)
    rows = [_row(name, n, window, scene, taken[n, window], bandwidth) for (n, window), scene in scenes.items()]
    _print(rows, bandwidth, name)
    write_report(
        out,
        {
            "counts": counts,
            "windows": windows,
            "backend": name,
            "focal": focal,
            "repeats": repeats,
            "seed": seed,
            "bytes": {"read": READ, "written": WRITTEN, "drawn": DRAWN, "pulled": PULLED},
        },
        summary={
            "copy_gb_per_s": bandwidth / 1e9,
            "lowest_share": min(row["share"] for row in rows),
            "highest_share": max(row["share"] for row in rows),
        },
        rows=rows,
    )


def _size(window: str) -> tuple[int, int]:
    width, _, height = window.partition("x")
    if not (width.isdigit() and height.isdigit() and int(width) and int(height)):
        raise FreeArtError(f"--windows: got '{window}', expected WIDTHxHEIGHT, such as 640x360")
    return int(width), int(height)


# --- what is drawn ----------------------------------------------------------------------------------------------------


def _scene(n: int, width: int, height: int, focal: float, seed: int) -> Scene:
    rng = np.random.default_rng([seed, n])
    lens = Lens(focal, focal, width / 2, height / 2, width, height)
    T = se3.pose(se3.exp_so3([0.5, 0.6, 0.0]), [0, 0, DISTANCE])
    poses = np.stack([T, T @ HINGE.transform(OPEN)])
    shape = (height, width)
    given = [rng.normal(size=s).astype(np.float32) for s in ((*shape, 3), shape, shape)]
    return Scene(_discs(n, rng), poses, lens, given)


def _discs(n: int, rng: np.random.Generator) -> Splats:
    """On the faces of two boxes, one on the other, each face by its area."""
    x, y, z = SIZE
    boxes = [((x, 0.7 * y, z), (0, 0.15 * y, 0)), ((x, 0.3 * y, z), (0, -0.35 * y, 0))]
    faces = [(box, axis, side) for box in range(2) for axis in range(3) for side in (-1, 1)]
    areas = np.array([np.prod(boxes[box][0]) / boxes[box][0][axis] for box, axis, _ in faces])
    which = rng.choice(len(faces), n, p=areas / areas.sum())
    box, axis, side = np.array(faces)[which].T
    sizes, centres = (np.array([b[k] for b in boxes]) for k in (0, 1))
    within = rng.uniform(-0.5, 0.5, (n, 3))
    within[np.arange(n), axis] = 0.5 * side
    ahead = np.array([[0.5, 0.5, 0.5, 0.5], [0.5, -0.5, -0.5, -0.5], [1, 0, 0, 0]])[axis]  # z to x, to y, to z
    outward = np.where((side > 0)[:, None], ahead, multiply(ahead, [0, 1, 0, 0]))
    across = 0.7 * np.sqrt(areas.sum() / n) * rng.lognormal(0, 0.3, (n, 2))
    return Splats(
        (centres[box] + within * sizes[box]).astype(np.float32),
        outward.astype(np.float32),
        np.column_stack([across, 0.1 * across.min(1)]).astype(np.float32),
        rng.uniform(0.3, 0.95, n).astype(np.float32),
        rng.uniform(0, 1, (n, 3)).astype(np.float32),
        box.astype(np.uint8),
    )


def _pairs(scene: Scene) -> float:
    """Area of all ellipses in which a Gaussian is not left out, pixels."""
    s, lens, T = scene.splats, scene.lens, scene.poses[scene.splats.motion]
    x, y, z = np.moveaxis((T[:, :3, :3] @ s.means[:, :, None])[:, :, 0] + T[:, :3, 3], 1, 0)
    zero = np.zeros_like(z)
    J = np.stack([lens.fx / z, zero, -lens.fx * x / z**2, zero, lens.fy / z, -lens.fy * y / z**2], 1).reshape(-1, 2, 3)
    M = J @ T[:, :3, :3] @ (se3.rotation_from_wxyz(s.quaternions) * s.scales[:, None, :])
    covariances = M @ np.swapaxes(M, 1, 2) + DILATION * np.eye(2)
    return float((2 * np.pi * np.log(s.opacities / FAINTEST) * np.sqrt(np.linalg.det(covariances))).sum())


def _step(scene: Scene, rasterise: Rasterise, focal: float) -> Callable[[], Any]:
    """One step of the optimisation of the scene's Gaussians, which may be called again and again."""
    s = scene.splats
    light = np.zeros((GaussianSettings().light_terms, 3), np.float32)
    light[0] = 1 / 0.28209479
    weights = np.where(s.motion == 0, 0.97, 0.03).astype(np.float32)
    arrays = (s.means, s.quaternions, np.log(s.scales), logit(s.opacities), s.colours, logit(weights), light)
    picture, _ = rasterise(_discs(len(s), np.random.default_rng(1)), scene.poses, scene.lens)
    seen = picture.alpha > 0.5
    depth = np.where(seen, picture.depth / np.maximum(picture.alpha, 0.5), 0).astype(np.float32)
    rgb = np.clip(255 * picture.colour, 0, 255).astype(np.uint8)
    frames = (Window(scene.lens, rgb, depth, seen, (0, 0)),)
    video = Windows(frames, DISTANCE / focal, noise=0.001, diagonal=float(np.linalg.norm(SIZE)), factor=1)
    poses = JointedPoses(HINGE, np.array([OPEN]), scene.poses[:1], np.array([0.01]), 0.0)
    own = Parameters(*(np.array(a, np.float32) for a in arrays))  # stepped in place
    settings = GaussianSettings()
    box = trimesh.creation.box(SIZE)
    surface = Mesh(box.vertices, box.faces)
    fit = Fit(video, (surface, surface), poses, rasterise, settings, np.random.default_rng(0))
    fit.parameters, fit.adam = own, Adam(own)
    fit.screen_sums, fit.views = np.zeros(len(own)), np.zeros(len(own))
    return lambda: fit.train_step(0, 0.5)


# --- measuring --------------------------------------------------------------------------------------------------------


def _measure(
    rasterise: Rasterise, scenes: dict[Any, Scene], focal: float, repeats: int
) -> tuple[float, dict[Any, Taken]]:
    """Bytes a second of a copy, and seconds of each scene's work, `repeats` of each."""
    source, target = np.ones(COPIED, np.uint8), np.zeros(COPIED, np.uint8)
    copies: list[float] = []
    taken = {key: Taken([], [], []) for key in scenes}
    steps = {key: _step(scene, rasterise, focal) for key, scene in scenes.items()}

    def copy(begin: int, end: int) -> None:
        np.copyto(target[begin:end], source[begin:end])

    for turn in range(repeats + 1):
        copies.append(_seconds(lambda: run_in_threads(copy, COPIED, 1))[0])
        for key, scene in scenes.items():
            forward, (picture, pull) = _seconds(lambda s=scene: rasterise(s.splats, s.poses, s.lens))
            backward, _ = _seconds(lambda p=pull, s=scene: p(*s.given))
            step, _ = _seconds(steps[key])
            if not picture.alpha.max() > 0.9:
                raise FreeArtError(f"{key} draws nothing that is opaque: there is nothing to measure")
            if turn:
                for seconds, now in zip(vars(taken[key]).values(), (forward, backward, step), strict=True):
                    seconds.append(now)
    return 2 * COPIED / statistics.median(copies[1:]), taken


def _seconds(work: Callable[[], Any]) -> tuple[float, Any]:
    begin = time.perf_counter()
    result = work()
    return time.perf_counter() - begin, result


def _row(backend: str, n: int, window: str, scene: Scene, taken: Taken, bandwidth: float) -> dict[str, Any]:
    pixels = scene.lens.width * scene.lens.height
    fewest = {"forward": n * READ + pixels * DRAWN, "backward": n * (READ + WRITTEN) + pixels * PULLED}
    both = [f + b for f, b in zip(taken.forward, taken.backward, strict=True)]
    pairs, middle = _pairs(scene), statistics.median(both)
    return {
        "backend": backend,
        "gaussians": n,
        "window": window,
        "forward_ms": 1e3 * statistics.median(taken.forward),
        "backward_ms": 1e3 * statistics.median(taken.backward),
        "iteration_ms": 1e3 * middle,
        "lowest_ms": 1e3 * min(both),
        "highest_ms": 1e3 * max(both),
        "step_ms": 1e3 * statistics.median(taken.step),
        "pairs": round(pairs),
        "ns_per_pair": 1e9 * middle / pairs,
        "limit_ms": 1e3 * sum(fewest.values()) / bandwidth,
        "share_forward": fewest["forward"] / bandwidth / statistics.median(taken.forward),
        "share_backward": fewest["backward"] / bandwidth / statistics.median(taken.backward),
        "share": sum(fewest.values()) / bandwidth / middle,
    }


def _print(rows: list[dict[str, Any]], bandwidth: float, backend: str) -> None:
    title = f"{backend}: milliseconds; px: pairs a pixel; ns: a pair; copying reaches {bandwidth / 1e9:.1f} GB/s"
    cells = []
    for row in rows:
        width, height = _size(row["window"])
        times = (f"{row[name]:.1f}" for name in ("forward_ms", "backward_ms", "iteration_ms", "step_ms"))
        pairs = f"{row['pairs'] / (width * height):.0f}", f"{row['ns_per_pair']:.2f}"
        cells.append((row["window"], row["gaussians"], *times, *pairs, f"{row['limit_ms']:.2f}", f"{row['share']:.3f}"))
    head = ("window", "count", "forward", "back", "both", "step", "px", "ns", "limit", "share")
    Console().print(make_table(title, head, cells))


if __name__ == "__main__":
    run_cli(main)
