"""The five steps between two films: measure, where, name, add, show."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from freeart21.camera_faults import CameraFaults, with_values
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.atomic import new_folder
from freeart21.files.camera_faults import write_camera_faults
from freeart21.files.lock import only_writer
from freeart21.files.places import ANSWER, check_place
from freeart21.files.sequence import read_sequence
from freeart21.recording import Recording
from simgap.film.answer import answered
from simgap.film.colour import colours
from simgap.film.counts import flying, holes, noise
from simgap.film.found import Found
from simgap.film.geometry import Geometry, search
from simgap.film.library import GEOMETRY, Design, about, depth_floor, design_of, faults_of, frames_split
from simgap.film.missing import missing_part
from simgap.film.samples import Rows, rows_of
from simgap.film.scene import FilmScene, read_scene
from simgap.film.verdict import FilmVerdict

MOST_FRAMES = 90
"""Frames that are compared, evenly drawn: a third of them confirms, enough for a standard error."""
LEAST_FRAMES = 12
PASSES = 3
"""Times that the film is simulated with the geometry found: columns are of first order."""
SETTLED_PX = 0.2
"""Pixels by which a further pass may move the picture and end it."""
ABSORBED = frozenset({"depth_scale", "depth_offset", "depth_curve", "focal_length", "principal_point"})
"""What an asset reconstructed from the same video has taken on."""

BASE = tuple(e for e in GEOMETRY if e.key == e.name and e.name not in ("depth_scale", "depth_offset", "depth_curve"))
"""Effects by which a film is simulated anew."""

Progress = Callable[[int, int], None]
Split = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]


@dataclass(frozen=True)
class Film:
    """What is compared."""

    recording: Recording
    scene: FilmScene
    depth_unit: float
    """Metres: the step of the measured depth."""


def find_film_gap(film: Film, progress: Progress | None = None) -> tuple[FilmVerdict, Found]:
    """What the simulated film lacks; nothing is written. Deterministic. Raises FreeArtError when films do not fit."""
    frames = _frames(film)
    split = frames_split(len(frames))
    tell = _teller(progress, len(frames) * (PASSES + 1))
    shut = ABSORBED if film.scene.same_video else frozenset[str]()
    if not _moves(film):
        shut |= {"depth_delay"}
    if film.scene.placed.exact:  # told in the frame of the colour camera
        shut |= {e.key for e in GEOMETRY if e.key != e.name}
    geometry, rows, design, camera, simulated_with = _geometry(film, frames, split, shut, tell)
    middle = float(np.median(rows["z"]))
    quiet = max(depth_floor(middle, film.depth_unit), film.depth_unit / np.sqrt(12))
    noisy = noise(rows, split, quiet)
    lost = holes(rows, split)
    said = replace(
        with_values(simulated_with, noisy.values),
        depth_scale=camera.depth_scale,
        depth_offset=camera.depth_offset,
        depth_curve=camera.depth_curve,
    )
    if said != simulated_with:  # what flies is told from what is noisy, or off as a whole
        rows = rows_of(film.recording, film.scene, frames, said, tell)
    families = (noisy, lost, flying(rows, split))
    drift = colours(rows, split, film.scene.same_video) if film.scene.coloured else None
    part = missing_part(film.recording, film.scene, rows, split)
    found = Found(
        film.recording,
        film.scene,
        frames,
        split,
        rows,
        design,
        geometry,
        camera,
        simulated_with,
        families,
        drift,
        part,
        shut,
        quiet,
    )
    return answered(found), found


def _geometry(
    film: Film, frames: NDArray[np.int64], split: Split, shut: frozenset[str], tell: Callable[[], None]
) -> tuple[Geometry, Rows, Design, CameraFaults, CameraFaults]:
    """The geometry, found anew about the film that was simulated with what was found before."""
    exact = film.scene.placed.exact
    camera = CameraFaults()
    for k in range(PASSES):
        rows = rows_of(film.recording, film.scene, frames, camera, tell)
        design = about(design_of(rows, film.depth_unit, exact), BASE, camera)
        geometry = search(design, split[0], split[1], shut, most=3 if k else 2)
        found = faults_of(design, geometry.chosen, geometry.fit.chosen, geometry.fit.beta)
        wanted = _to_simulate(geometry, found)
        if k == PASSES - 1 or _shift(film.recording, wanted, camera) < SETTLED_PX:
            break
        camera = wanted
    return geometry, rows, design, found, camera


def _to_simulate(geometry: Geometry, found: CameraFaults) -> CameraFaults:
    """The geometry alone. Where the poses go with the depth picture the colour picture is what is moved."""
    keys = {e.key for e in geometry.chosen}
    wanted = replace(found, depth_scale=0.0, depth_offset=0.0, depth_curve=0.0)
    if "misregistration, poses by depth" in keys:
        wanted = replace(
            wanted,
            centre_u=found.centre_u - found.depth_shift_u,
            centre_v=found.centre_v - found.depth_shift_v,
            depth_turn=0.0,
        )
    return replace(wanted, depth_delay=0.0) if "depth_delay, poses by depth" in keys else wanted


def _shift(recording: Recording, new: CameraFaults, old: CameraFaults) -> float:
    """Pixels by which two cameras' pictures differ at most, roughly; a delay counts a pixel for every 5 ms."""
    reach = 0.25 * float(np.hypot(recording.camera.width, recording.camera.height))
    return max(
        reach * abs(new.focal - old.focal),
        float(np.hypot(new.centre_u - old.centre_u, new.centre_v - old.centre_v)),
        float(np.hypot(new.depth_shift_u - old.depth_shift_u, new.depth_shift_v - old.depth_shift_v)),
        reach * abs(new.depth_turn - old.depth_turn),
        abs(new.depth_delay - old.depth_delay) / 5e-3,
    )


def _frames(film: Film) -> NDArray[np.int64]:
    """Frames with known poses, evenly drawn."""
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
    if len(seen) > MOST_FRAMES:
        seen = seen[np.linspace(0, len(seen) - 1, MOST_FRAMES).round().astype(int)]
    return seen


def _moves(film: Film) -> bool:
    """Whether the object moves in the picture, so that a delay would show: by a pixel a frame in the median."""
    Ts, scene, camera = film.scene.placed.Ts, film.scene, film.recording.camera
    speed = []
    for k, part in enumerate(scene.parts):
        corners = np.array(np.meshgrid(*np.stack([part.vertices.min(0), part.vertices.max(0)]).T)).reshape(3, -1).T
        at = np.stack([camera.project(corners @ T[:3, :3].T + T[:3, 3]) for T in Ts[k]])
        speed.append(np.linalg.norm(np.diff(at, axis=0), axis=-1).max(1))
    return bool(np.nanmedian(np.max(speed, 0)) >= 0.5)


def _teller(progress: Progress | None, total: int) -> Callable[[], None]:
    done = [0]

    def tell() -> None:
        done[0] += 1
        if progress is not None:
            progress(min(done[0], total), total)

    return tell


def is_sequence(path: Path) -> bool:
    """Whether a folder is a video's, and no measured set's."""
    return (Path(path) / "sequence.json").is_file()


def read_film(asset: Path, sequence: Path, poses: Path | None = None, root: Path | None = None) -> Film:
    """Asset (what its URDF names is read inside `root`), video and poses from files."""
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
    from simgap.film.page import write_page

    inputs = [asset, sequence] if poses is None else [asset, sequence, poses]
    check_place(out, ANSWER, inputs)
    film = read_film(asset, sequence, poses, root)
    with only_writer(out), new_folder(out, ANSWER) as aside:
        began = time.perf_counter()
        verdict, found = find_film_gap(film, progress)
        if not verdict.camera.none:
            write_camera_faults(aside / "camera.json", verdict.camera)
        write_page(aside / "index.html", verdict, found, time.perf_counter() - began)
        verdict.write(aside / "verdict.json")
    return verdict
