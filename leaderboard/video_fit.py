"""Checks without the truth whether an answer's posed parts lie on the object in the video, and suggests a correction.

Files with poses in OpenGL's camera axes, inverse poses or lengths in millimetres read well but score badly. The video's
masks and depth reveal them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.formats.third_party import T_GL_CV
from freeart21.mesh import Mesh
from freeart21.reconstruction import Piece, Reconstruction
from freeart21.recording import Recording
from freeart21.se3 import Array
from leaderboard.adapters.readers import scale_poses
from leaderboard.surface import Surface

FRAMES = 5
"""Evenly spaced frames that are compared."""
POINTS = 1500
"""Sampled on the surface of each part."""
CELLS = 12
"""Grid cells along the mask's longer side; a cell with a point of the answer is covered."""
DOES_NOT_FIT = 0.4
FITS = 0.6
"""Fits below DOES_NOT_FIT are reported; a correction is suggested when it fits by FITS.

Measured on 14 recordings (clean and time of flight) of our objects and PartNet's: truths fit by 0.89 to 0.98, the
solver's answers by 0.68 to 0.98, truths with a static moving part by 0.71 and more, with poses of frame 0 throughout by
0.35 (scissors) to 0.84, with meshes 1.3 times too large by 0.48 and more. Answers in OpenGL's axes, in mm, or with
quaternions in the other order fit by 0 to 0.31.
"""
EQUAL = 0.03
"""Explanations whose fits differ by less are equal; the first, simplest one is suggested."""
UNITS = {"": 1.0, "lengths were in mm (import --scale 0.001)": 1e-3, "lengths were in cm (import --scale 0.01)": 1e-2}


@dataclass(frozen=True)
class _Picture:
    """The object in one picture of the video."""

    camera: Camera
    mask: NDArray[np.bool_]
    depth: NDArray[np.float32]
    """Metres; the object's median depth where a pixel has none."""
    size: float
    """Metres, the diagonal of the visible surface; infinite without depth."""


def describe_misfit(answer: Reconstruction, recording: Recording, lacks: tuple[Piece, ...] = ()) -> str:
    """One line if the parts of `answer` do not lie on the object in its video, or the video cannot be read; else ''.

    `lacks` are the pieces that are fillers. Without meshes nothing is checked; without poses, only the anchor frame.
    """
    if "meshes" in lacks or any(part.empty for part in _parts(answer)):
        return ""
    chosen_frames = {round(i) for i in np.linspace(0, len(recording) - 1, FRAMES)}
    try:
        wanted = [answer.anchor] if "poses" in lacks else sorted(chosen_frames)
        pictures = {i: _read_picture(recording, i) for i in wanted}
    except FreeArtError as error:
        return f"whether the parts lie on the object in the video is not known: {error}"
    frames = [i for i, picture in pictures.items() if picture is not None]
    chosen = [picture for picture in pictures.values() if picture is not None]
    if not chosen:
        return ""
    reference = answer.Ts_camera_reference[frames]
    moving = (
        reference @ answer.articulation.joint.transform(answer.states[frames])
        if "poses" in lacks
        else answer.Ts_camera_moving[frames]
    )
    Ts = np.stack([reference, moving])
    points = [Surface(part).sample(POINTS, (7, k)) for k, part in enumerate(_parts(answer))]
    fit = _fit(points, Ts, chosen)
    if fit >= DOES_NOT_FIT:
        return ""
    where = ", ".join(map(str, frames))
    message = f"the parts, posed by the answer, fit the video's masks and depth to {fit:.0%} (frames {where})"
    candidates = []
    for length, unit in UNITS.items():
        scaled = [unit * p for p in points]
        for name, poses in _other_poses(Ts).items():
            words = " and ".join(word for word in (name, length) if word)
            candidates.append((_fit(scaled, scale_poses(poses, unit), chosen), words))
    best, name = next(pair for pair in candidates if pair[0] >= max(candidates)[0] - EQUAL)
    if best < FITS:
        return f"{message}; none of the other axes and units fits"
    return f"{message}; {best:.0%} would do if {name}"


def _parts(answer: Reconstruction) -> tuple[Mesh, Mesh]:
    return answer.articulation.reference, answer.articulation.moving


def _read_picture(recording: Recording, index: int) -> _Picture | None:
    frame = recording.frame(index)
    if not frame.mask.any():
        return None
    measured = frame.mask & (frame.depth > 0)
    points = recording.camera.backproject(frame.depth)[measured]
    size = float(np.linalg.norm(np.ptp(np.percentile(points, [2, 98], axis=0), axis=0))) if len(points) else np.inf
    middle = np.median(frame.depth[measured]) if len(points) else 0.0
    return _Picture(recording.camera, frame.mask, np.where(frame.depth > 0, frame.depth, np.float32(middle)), size)


def _fit(points: list[Array], Ts: Array, pictures: list[_Picture]) -> float:
    """Fit in [0, 1]: mean over pictures of the smaller of two fractions, points on the object and covered mask cells.

    A point is on the object if its pixel is in the mask and its depth differs from the video's by at most the object's
    size (the far side is deeper). Without depth the mask alone decides.
    """
    fits = []
    for k, picture in enumerate(pictures):
        posed = np.concatenate([se3.transform(T[k], p) for T, p in zip(Ts, points, strict=True)])
        uv = picture.camera.project(posed)
        height, width = picture.mask.shape
        inside = np.isfinite(uv).all(1) & (uv >= 0).all(1) & (uv < [width, height]).all(1)
        column, row = uv[inside].astype(int).T
        depth, z = picture.depth[row, column], posed[inside, 2]
        on = picture.mask[row, column] & (np.abs(z - depth) <= picture.size)
        rows, columns = np.nonzero(picture.mask)
        cell = max(1.0, (max(np.ptp(rows), np.ptp(columns)) + 1) / CELLS)
        cells = {*zip((rows / cell).astype(int).tolist(), (columns / cell).astype(int).tolist(), strict=True)}
        covered = {*zip((row[on] / cell).astype(int).tolist(), (column[on] / cell).astype(int).tolist(), strict=True)}
        fits.append(min(np.count_nonzero(on) / len(posed), len(cells & covered) / len(cells)))
    return float(np.mean(fits))


def _other_poses(Ts: Array) -> dict[str, Array]:
    """Possible mistakes in the poses (2, n, 4, 4), to complete 'if ...', with the corrected poses; none first."""
    return {
        "": Ts,
        "the poses were in OpenGL's camera axes (import --axes or --frame, where the layout has one)": T_GL_CV @ Ts,
        "the poses and the object's frame had OpenGL's axes (import --axes opengl)": T_GL_CV @ Ts @ T_GL_CV,
        "the poses were camera to object": se3.inverse(Ts),
    }
