"""Cameras with one fault each, put upon a clean film. Written apart: nothing here is shared with the recorder's sensors
or with what looks for the faults.

A film is a recording in memory. A fault takes a film and a size, and gives another film.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import ndimage

from freeart21.camera import Camera
from freeart21.recording import Frame, Recording

Change = Callable[[int, Frame, np.random.Generator], Frame]


def film_of(recording: Recording) -> Recording:
    """The recording with all its frames in memory."""
    frames = [recording.frame(i) for i in range(len(recording))]
    return replace(recording, load=lambda i: frames[i])


def changed(film: Recording, change: Change, seed: int = 0) -> Recording:
    """Every frame changed by a function of its number, the frame and a generator of its own."""
    frames = [change(i, film.frame(i), np.random.default_rng((seed, 977, i))) for i in range(len(film))]
    return replace(film, load=lambda i: frames[i])


def with_depth(frame: Frame, depth: np.ndarray) -> Frame:
    return Frame(frame.rgb, np.where(frame.depth > 0, np.maximum(depth, 0), 0).astype(np.float32), frame.mask)


def reads_long(film: Recording, share: float) -> Recording:
    return changed(film, lambda i, f, rng: with_depth(f, f.depth * (1 + share)))


def reads_off(film: Recording, metres: float) -> Recording:
    return changed(film, lambda i, f, rng: with_depth(f, f.depth + metres))


def bends(film: Recording, per_metre: float) -> Recording:
    return changed(film, lambda i, f, rng: with_depth(f, f.depth + per_metre * f.depth**2))


def rustles(film: Recording, metres_at_one: float, power: float = 2.0) -> Recording:
    """Every pixel by itself, more from afar."""

    def change(i: int, f: Frame, rng: np.random.Generator) -> Frame:
        return with_depth(f, f.depth + metres_at_one * f.depth**power * rng.normal(size=f.depth.shape))

    return changed(film, change)


def blind_to_dark(film: Recording, level: float) -> Recording:
    """No depth where the picture is darker than `level`, 0 to 1, for nine of ten pixels."""

    def change(i: int, f: Frame, rng: np.random.Generator) -> Frame:
        dark = f.rgb.astype(float).mean(2) < 255 * level
        return with_depth(f, np.where(dark & (rng.random(dark.shape) < 0.9), 0, f.depth))

    return changed(film, change)


def tilt_of(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Angle between the line of sight and the surface's normal, degrees, by crossed differences of points."""
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    points = np.stack([(u - camera.K[0, 2]) / camera.K[0, 0], (v - camera.K[1, 2]) / camera.K[1, 1], np.ones_like(u)])
    points = points * depth
    across = np.stack([np.gradient(p, axis=1) for p in points])
    down = np.stack([np.gradient(p, axis=0) for p in points])
    n = np.cross(across, down, axis=0)
    cosine = np.abs((n * points).sum(0)) / np.maximum(np.linalg.norm(n, axis=0) * np.linalg.norm(points, axis=0), 1e-12)
    return np.degrees(np.arccos(np.clip(cosine, 0, 1)))


def blind_to_slopes(film: Recording, degrees: float) -> Recording:
    """No depth on surfaces seen flatter than an angle, for eight of ten pixels."""

    def change(i: int, f: Frame, rng: np.random.Generator) -> Frame:
        inside = ndimage.binary_erosion(f.depth > 0, iterations=2)
        flat = (tilt_of(f.depth, film.camera) > degrees) & inside
        return with_depth(f, np.where(flat & (rng.random(flat.shape) < 0.8), 0, f.depth))

    return changed(film, change)


def frays(film: Recording, share: float, reach: int = 2) -> Recording:
    """Pixels at the object's rim hang between it and a wall 1.5 m behind."""

    def change(i: int, f: Frame, rng: np.random.Generator) -> Frame:
        on = f.depth > 0
        rim = on & ~ndimage.binary_erosion(on, iterations=reach)
        hung = rim & (rng.random(on.shape) < share)
        return with_depth(f, np.where(hung, f.depth + rng.random(on.shape) * 1.5, f.depth))

    return changed(film, change)


def slips(film: Recording, right: float, down: float, degrees: float = 0.0) -> Recording:
    """The depth picture lies beside the colour picture."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    centre = film.camera.K[1::-1, 2] - 0.5  # row, column
    back = np.array([[c, -s], [s, c]])  # rows and columns of where a pixel's depth comes from

    def change(i: int, f: Frame, rng: np.random.Generator) -> Frame:
        offset = centre - back @ (centre + np.array([down, right]))
        return Frame(f.rgb, ndimage.affine_transform(f.depth, back, offset, order=0), f.mask)

    return changed(film, change)


def scale_focal(film: Recording, share: float) -> Recording:
    """The lens is longer than given, by a share."""
    K = np.array(film.camera.K)
    K[0, 0] /= 1 + share
    K[1, 1] /= 1 + share
    return replace(film, camera=Camera(K, film.camera.width, film.camera.height))


def shift_centre(film: Recording, right: float, down: float) -> Recording:
    """The lens looks right of, and below, where the file has it."""
    K = np.array(film.camera.K)
    K[0, 2] -= right
    K[1, 2] -= down
    return replace(film, camera=Camera(K, film.camera.width, film.camera.height))


def lags(film: Recording, frames: int) -> Recording:
    """The depth picture is some frames old."""

    def change(i: int, f: Frame, rng: np.random.Generator) -> Frame:
        return Frame(f.rgb, film.frame(max(i - frames, 0)).depth, f.mask)

    return changed(film, change)


def _linear(rgb: np.ndarray) -> np.ndarray:
    x = rgb / 255.0
    return np.where(x > 0.04045, ((x + 0.055) / 1.055) ** 2.4, x / 12.92)


def _coded(linear: np.ndarray) -> np.ndarray:
    x = np.clip(linear, 0, 1)
    return np.rint(255 * np.where(x > 0.0031308, 1.055 * x ** (1 / 2.4) - 0.055, 12.92 * x)).astype(np.uint8)


def brightens(film: Recording, stops: float) -> Recording:
    """The exposure goes up and, half as far, down again."""

    def change(i: int, f: Frame, rng: np.random.Generator) -> Frame:
        t = i / max(len(film) - 1, 1)
        gain = 2.0 ** (stops * np.interp(t, [0, 0.6, 1], [-0.5, 0.5, 0.0]))
        return Frame(_coded(_linear(f.rgb) * gain), f.depth, f.mask)

    return changed(film, change)


def steepens(film: Recording, exponent: float) -> Recording:
    """The tone curve bends from 1 - exponent to 1 + exponent."""

    def change(i: int, f: Frame, rng: np.random.Generator) -> Frame:
        t = i / max(len(film) - 1, 1)
        return Frame(_coded(_linear(f.rgb) ** (1 + exponent * (2 * t - 1))), f.depth, f.mask)

    return changed(film, change)


# --- what no library has ----------------------------------------------------------------------------------------------


def rolling_vignette(film: Recording, depth: float) -> Recording:
    """A dark corner that walks round the picture."""
    v, u = np.mgrid[: film.camera.height, : film.camera.width]
    v, u = 2 * v / film.camera.height - 1, 2 * u / film.camera.width - 1

    def change(i: int, f: Frame, rng: np.random.Generator) -> Frame:
        a = 2 * np.pi * i / 20
        shade = 1 - depth * np.clip(0.5 + 1.5 * (u * np.cos(a) + v * np.sin(a)), 0, 1)
        return Frame(_coded(_linear(f.rgb) * shade[..., None]), f.depth, f.mask)

    return changed(film, change)


def second_bounce(film: Recording, metres: float) -> Recording:
    """A smooth bump of the depth that stands still in the picture, as light by way of a wall makes it."""
    v, u = np.mgrid[: film.camera.height, : film.camera.width]
    size = 0.12 * film.camera.width
    bump = metres * np.exp(
        -0.5 * (((u - 0.55 * film.camera.width) / size) ** 2 + ((v - 0.45 * film.camera.height) / size) ** 2)
    )
    return changed(film, lambda i, f, rng: with_depth(f, f.depth + bump))


def breathes(film: Recording, metres: float) -> Recording:
    """All depth goes to and fro, ten frames a turn."""
    return changed(film, lambda i, f, rng: with_depth(f, f.depth + metres * np.sin(2 * np.pi * i / 10)))
