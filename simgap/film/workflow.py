"""The five steps of `gap` between two films: measure, localise, name, add, show."""

from __future__ import annotations

import shlex
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from freeart21.camera_faults import CameraFaults
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.camera_faults import write_camera_faults
from freeart21.files.sequence import read_sequence
from simgap.film import pixel_faults
from simgap.film.answer import FilmVerdict, QuantityGap, confirm, verdict_of
from simgap.film.choose import Chosen, Frames, choose
from simgap.film.colour import colour_design, colour_kind
from simgap.film.effects import camera_of, parameters_of
from simgap.film.geometry import PICTURE, Design, depth_floor, geometry_kind, make_design
from simgap.film.maps import film_maps
from simgap.film.missing import find_missing_part
from simgap.film.page import page
from simgap.film.proof import UNITS, floors, measure_gaps
from simgap.film.result import Film, FilmResult
from simgap.film.samples import Rows, sample_rows
from simgap.film.scene import read_scene
from simgap.verdict import root_mean_square

MOST_FRAMES = 90
"""Frames that are compared, evenly spaced; a third of them confirms."""
LEAST_FRAMES = 12
PASSES = 3
"""Times that the film is simulated with the estimated geometry, since columns are of first order."""
SETTLED_PX = 0.2
"""Shift of the outlines, pixels, at convergence."""
ABSORBED = frozenset({"depth_scale", "depth_offset", "depth_curve", "focal_length", "principal_point"})
"""Faults that an asset reconstructed from the same video has absorbed."""

Progress = Callable[[int, int], None]


def find_film_gap(film: Film, progress: Progress | None = None) -> tuple[FilmVerdict, FilmResult]:
    """The effects that the simulated film lacks. Writes nothing; deterministic. Raises FreeArtError when films do not
    match."""
    recording, scene = film.recording, film.scene
    frames = _frames(film)
    split = _split(len(frames))
    done, total = [0], len(frames) * PASSES + 2 * len(split[2])

    def rows_with(camera: CameraFaults, some: Frames) -> Rows:
        def report() -> None:
            done[0] += 1
            if progress is not None:
                progress(min(done[0], total), total)

        return sample_rows(recording, scene, frames[some], camera, report)

    shut = ABSORBED if not scene.placed.exact else frozenset[str]()
    first, rows, found = _geometry(film, rows_with, split, shut if _moves(film) else shut | {"depth_delay"})
    quiet = max(depth_floor(float(np.median(rows["z"])), film.depth_unit), film.depth_unit / np.sqrt(12))
    kinds = [found, choose(pixel_faults.noise_kind(rows, quiet), split), choose(pixel_faults.holes_kind(rows), split)]
    known = camera_of(effect for kind in kinds for effect in kind.effects)
    kinds.append(choose(pixel_faults.flying_kind(rows, known), split))
    drift = colour_design(rows) if scene.coloured else None
    if drift is not None:
        kinds.append(choose(colour_kind(drift, lit=not scene.placed.exact), split))
    simulated = {_picture(CameraFaults()): first.only(split[2])}

    def measure(camera: CameraFaults) -> dict[str, float]:
        key = _picture(camera)
        if key not in simulated:
            simulated[key] = rows_with(key, split[2])
        every = camera_of(effect for kind in kinds for effect in kind.effects)
        gaps = measure_gaps(simulated[key], camera, every, quiet, film.depth_unit)
        return {what: size for what, size in gaps.items() if drift is not None or what in list(UNITS)[:-1]}

    confirmed = confirm(kinds, measure)
    floor = floors(rows, confirmed.best, quiet, film.depth_unit)
    before, after, trial = (measure(c) for c in (CameraFaults(), confirmed.delivered, confirmed.best))
    tried = confirmed.best != confirmed.delivered
    gaps = tuple(
        QuantityGap(
            *(recording.name, size, after[what], floor[what], True, what, "confirming"),
            *(trial[what] if tried else None, UNITS[what]),
        )
        for what, size in before.items()
    )
    maps = film_maps(first, drift is not None)
    part = find_missing_part(recording, scene, rows, split)
    numbers = {k: frames[i].tolist() for k, i in zip(("fit", "choose", "confirm"), split, strict=True)}
    verdict = verdict_of(kinds, confirmed, gaps, maps, part, scene, rows, numbers)
    return verdict, FilmResult(film, tuple(kinds), maps, first)


def _picture(camera: CameraFaults) -> CameraFaults:
    """Geometry and timing of a camera, with which a film is simulated."""
    return CameraFaults(**{f: getattr(camera, f) for n in PICTURE for f in parameters_of(n)})


def _geometry(
    film: Film,
    rows_with: Callable[[CameraFaults, Frames], Rows],
    split: tuple[Frames, Frames, Frames],
    shut: frozenset[str],
) -> tuple[Rows, Rows, Chosen]:
    """Rows of the film as it is, rows of the film simulated with the estimated geometry, and that geometry, by
    relinearisation."""
    camera, every = CameraFaults(), np.sort(np.concatenate(split))
    first: Rows | None = None
    for _ in range(PASSES):
        rows = rows_with(camera, every)
        first = first or rows
        design = make_design(rows, film.depth_unit, film.scene.placed.exact, camera)
        found = choose(geometry_kind(design, shut), split)
        wanted = camera_of(effect for effect in found.effects if effect.name in PICTURE)
        if _shift(design, wanted, camera) < SETTLED_PX:
            break
        camera = wanted
    assert first is not None
    return first, rows, found


def _shift(design: Design, new: CameraFaults, old: CameraFaults) -> float:
    """RMS shift, pixels, between the outlines of two cameras' pictures, to first order."""
    beta = np.array([getattr(new, f) - getattr(old, f) for n in PICTURE for f in parameters_of(n)])
    columns = [c for n in PICTURE for c in design.columns[n]]
    return max(root_mean_square(b.columns[:, columns] @ beta) for b in design.blocks[1:])


def _split(n: int) -> tuple[Frames, Frames, Frames]:
    """Frames to fit, choose and confirm: alternating stretches, since neighbours are redundant."""
    turn = (np.arange(n) // max(1, n // 30)) % 3
    return np.flatnonzero(turn == 0), np.flatnonzero(turn == 1), np.flatnonzero(turn == 2)


def _frames(film: Film) -> Frames:
    """Frames with known poses, evenly spaced."""
    n, placed = len(film.recording), film.scene.placed
    if len(placed.Ts[0]) != n:
        raise FreeArtError(
            f"{film.recording.name} has {n} frames, but {placed.source} has poses of {len(placed.Ts[0])}: "
            "expected those of this video"
        )
    seen = np.flatnonzero(placed.seen)
    if len(seen) < LEAST_FRAMES:
        raise FreeArtError(
            f"{film.recording.name} shows both parts in {len(seen)} frames, expected {LEAST_FRAMES} or more"
        )
    return seen[np.linspace(0, len(seen) - 1, min(len(seen), MOST_FRAMES)).round().astype(int)]


def _moves(film: Film) -> bool:
    """Whether the object moves in the picture by half a pixel a frame in the median, so that a delay would show."""
    speed = []
    for k, Ts in enumerate(film.scene.placed.Ts, 1):
        own = film.scene.vertices[film.scene.part == k]
        corners = np.array(np.meshgrid(*np.stack([own.min(0), own.max(0)]).T)).reshape(3, -1).T
        at = np.stack([film.recording.camera.project(corners @ T[:3, :3].T + T[:3, 3]) for T in Ts])
        speed.append(np.linalg.norm(np.diff(at, axis=0), axis=-1).max(1))
    return bool(np.nanmedian(np.max(speed, 0)) >= 0.5)


def read_film(asset: Path, sequence: Path, poses: Path | None = None, root: Path | None = None) -> Film:
    """Asset (referenced files inside `root`), video and poses from files."""
    recording = read_sequence(sequence)
    unit = float(checked.read_json(Path(sequence) / "sequence.json")["depth_scale"])
    return Film(recording, read_scene(asset, sequence, poses, root), unit)


def film_gap_folder(
    asset: Path,
    sequence: Path,
    out: Path,
    poses: Path | None = None,
    progress: Progress | None = None,
    root: Path | None = None,
) -> FilmVerdict:
    """`find_film_gap` from folders to a folder with verdict.json, camera.json and a page, whole or not at all."""
    from simgap.page.publish import answer_folder, write_answer

    inputs = [asset, sequence] if poses is None else [asset, sequence, poses]
    options = [f"--{name} {shlex.quote(str(path))}" for name, path in (("poses", poses), ("root", root)) if path]
    command = " ".join([shlex.join(["freeart21", "gap", str(asset), str(sequence), "--out", str(out)]), *options])
    with answer_folder(out, inputs) as folder:
        film = read_film(asset, sequence, poses, root)
        began = time.perf_counter()
        verdict, found = find_film_gap(film, progress)
        if not verdict.camera.is_ideal:
            write_camera_faults(folder / "camera.json", verdict.camera)
        write_answer(folder, verdict, "revolute", page(verdict, found, command, time.perf_counter() - began))
    return verdict
