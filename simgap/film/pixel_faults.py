"""Pixel noise, holes and flying pixels of depth pictures.

Each is a small family of models with a likelihood per pixel, judged by frames as the geometry is.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from freeart21.camera_faults import CameraFaults
from freeart21.se3 import Array
from simgap.film.choose import Frames, Kind, SetFit
from simgap.film.effects import parameters_of
from simgap.film.samples import EDGE_SHARE, Rows

WILD = 0.02
"""Share of outliers, off by up to a metre; the rest of the noise is Gaussian. Not measured."""
LEAST_DEPTH = 5e-4
"""Least noise that is named, as a share of the distance (`geometry.LEAST_DEPTH`)."""
LEAST_MORE = 0.05
"""Share of the best set's gain that another kind of holes must add: creases lose pixels, too, and are darker."""
SMOOTH = 0.2
"""Least RMS difference of neighbours over that of pixels four apart, for noise. For a smooth error it is a sixteenth,
for a Kinect's smoothed noise .7 (the foam tube, .25 against .35 mm)."""
LEAST_NOISE = 1.5
"""Least pixel noise that is named, in floors."""
LEAST_EXPONENT = 0.2
"""Least exponent of noise over distance or angle that is named. Not measured."""
LEAST_HOLES, LEAST_FLYING = 0.01, 0.1
"""Least share of pixels (of the object; at its edges) that is named; a mask's rim is wrong for as many."""
FLOOR_RATE = 2e-3
"""Share of pixels that may be lost, or fly, without a fault."""
BINS = (30, 24)
"""Bins of brightness and of the angle of incidence, for holes."""
NOISE, LOST, FLYING = "noise of single pixels", "pixels lost", "pixels that fly at edges"
_PLACE = "place in the picture"


def robust_deviation(e: Array, otherwise: float = 0.0) -> float:
    """Standard deviation by the median absolute value."""
    return float(np.median(np.abs(e)) * 1.4826) if len(e) > 20 else otherwise


def noise_kind(rows: Rows, floor: float) -> Kind:
    """Pixel noise, from differences of nearby pixels, which poses and smooth shapes do not affect.

    `floor` is the contribution of depth quantisation and the asset's roughness, metres.
    """
    usable = np.flatnonzero(np.isfinite(rows["pair"]))
    e, z, cosine = rows["pair"][usable], rows["z"][usable], np.maximum(rows["cosine"][usable], 0.05)
    frame, cell = rows.of("pair")[usable], _cells(rows["at"][usable])
    middle = float(np.median(z)) if len(z) else 1.0
    near = np.abs(rows["near"][np.isfinite(rows["near"])])
    neighbour_rms = float(np.sqrt(np.mean(np.minimum(near, np.quantile(near, 0.95)) ** 2))) if len(near) else 0.0
    growths = {"noise_growth": np.log(np.maximum(z, 1e-6) / middle), "noise_grazing": -np.log(cosine)}

    def fit(names: tuple[str, ...], frames: Frames, rival: str) -> SetFit | None:
        on, values, matters = np.isin(frame, frames), dict[str, float](), True
        size = np.zeros(len(e))
        if rival:
            whole = robust_deviation(e[on])
            size = np.array([robust_deviation(e[on & (cell == c)], whole) for c in range(16)])[cell]
        elif names:
            if names[0] != "axial_noise":
                return None
            features = np.stack([np.ones(len(e)), *(growths[name] for name in names[1:])], -1)
            beta = _fit_scale(e[on], features[on], floor)
            size = np.exp(np.clip(features @ beta, -30, 5))
            values = {"noise": float(np.exp(beta[0])), "noise_at": middle}
            values |= {name: float(np.clip(b, -4, 8)) for name, b in zip(names[1:], beta[1:], strict=True)}
            matters = (
                max(LEAST_NOISE * floor, LEAST_DEPTH * middle) <= values["noise"] <= neighbour_rms / SMOOTH
                and abs(values.get("noise_growth", 1.0)) >= LEAST_EXPONENT
                and values.get("noise_grazing", 1.0) >= LEAST_EXPONENT
            )
        logs = _log_noise(e, np.hypot(floor, size))
        return SetFit(values, lambda some: _sum_by_frame(logs, frame, some), matters)

    return Kind("noise", ("axial_noise", *growths), fit, (_PLACE,), 0.0, (NOISE,))


def _fit_scale(e: Array, features: Array, floor: float) -> Array:
    """Maximum-likelihood coefficients of the log scale of `e` (n,), with the additional noise `floor`."""
    step = max(1, len(e) // 8000)
    e, features = e[::step], features[::step]
    first = np.zeros(features.shape[1])
    first[0] = np.log(max(robust_deviation(e), floor, 1e-7))

    def loss(beta: Array) -> float:
        scale = np.hypot(floor, np.exp(np.clip(features @ beta, -30, 5)))
        return float(-_log_noise(e, scale).mean() + 1e-3 * (beta[1:] ** 2).sum())

    return np.asarray(minimize(loss, first, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-6}).x)


def _log_noise(e: Array, scale: Array) -> Array:
    """Log density of noise with standard deviation `scale`, metres."""
    return np.asarray(np.log((1 - WILD) * 0.39894 * np.exp(-0.5 * (e / scale) ** 2) / scale + WILD))


def count_holes(rows: Rows) -> tuple[Array, Array]:
    """(frames, brightness, angle) of all pixels of the object, and of those without depth."""
    angle = np.arccos(np.clip(rows["cosine"], 0, 1)) / (np.pi / 2)
    values = zip((rows["measured_brightness"], angle), BINS, strict=True)
    at = rows.of("error"), *(np.minimum((x * n).astype(int), n - 1) for x, n in values)
    every, lost = np.zeros((2, len(rows.frames), *BINS))
    np.add.at(every, at, 1)
    np.add.at(lost, at, np.isnan(rows["error"]))
    return every, lost


def hole_rate(camera: CameraFaults) -> Array:
    """(brightness, angle) share of the pixels that a camera loses."""
    light, slope = ((np.arange(n) + 0.5) / n for n in BINS)
    return camera.hole_probability(light[:, None], np.cos(slope * np.pi / 2)[None])


def holes_kind(rows: Rows) -> Kind:
    """Pixels without depth inside the object: anywhere, on dark surfaces, at grazing incidence."""
    lost, frame = np.isnan(rows["error"]), rows.of("error")
    every, gone = count_holes(rows)
    cells = {_PLACE: _cells(rows["at"]), "part": rows["part"]}
    dark_end = float(np.quantile(rows["measured_brightness"], 0.95)) if len(lost) else 1.0
    flat_end = float(np.arccos(np.clip(np.quantile(rows["cosine"], 0.95), 0, 1))) if len(lost) else 0.0
    ceiling = {"dark_level": 0.8, "grazing_angle": np.pi / 2}

    def fit(names: tuple[str, ...], frames: Frames, rival: str) -> SetFit:
        if rival:
            on, key = np.isin(frame, frames), cells[rival]
            share = (np.bincount(key[on], lost[on], 16) + 0.5) / (np.bincount(key[on], minlength=16) + 1 / FLOOR_RATE)
            logs = np.where(lost, np.log(share[key]), np.log1p(-np.minimum(share[key], 1 - 1e-3)))
            return SetFit({}, lambda some: _sum_by_frame(logs, frame, some))
        fields = [field for name in names for field in parameters_of(name)]
        total, g = every[frames].sum(0), gone[frames].sum(0)

        def values_of(x: Array) -> dict[str, Any]:
            shares = 0.5 * (1 + np.tanh(0.5 * x))  # between 0 and the ceiling
            return {f: float(ceiling.get(f, 0.995) * s) for f, s in zip(fields, shares, strict=True)}

        def logs_of(values: dict[str, Any], total: Array, g: Array) -> Array:
            p = np.clip(hole_rate(CameraFaults(**values)), FLOOR_RATE, 1 - 1e-3)
            return np.asarray(g * np.log(p) + (total - g) * np.log(1 - p))

        def loss(x: Array) -> float:
            return -float(logs_of(values_of(x), total, g).sum() / max(total.sum(), 1))

        values = dict[str, Any]()
        if names:
            levels = [(level, tilt) for level in (0.08, 0.2, 0.35, 0.5) for tilt in np.radians((45.0, 60.0, 75.0))]
            shares = [
                [{"holes": 0.02, "dark_level": a / 0.8, "grazing_angle": b / (np.pi / 2)}.get(f, 0.7) for f in fields]
                for a, b in levels
            ]
            first = min((np.log(s) - np.log1p(-np.array(s)) for s in shares), key=loss)
            options = {"xatol": 1e-3, "fatol": 1e-7, "maxiter": 600}
            values = values_of(minimize(loss, first, method="Nelder-Mead", options=options).x)
        own = [
            float((total * hole_rate(CameraFaults(**{f: values[f] for f in parameters_of(n)}))).sum()) for n in names
        ]
        inside = values.get("dark_level", 0.0) < dark_end and values.get("grazing_angle", 2.0) > flat_end
        matters = inside and min(own, default=np.inf) >= LEAST_HOLES * total.sum()  # each explains enough pixels
        return SetFit(values, lambda some: logs_of(values, every[some], gone[some]).sum((1, 2)), matters)

    return Kind("holes", ("holes", "dark_holes", "grazing_holes"), fit, tuple(cells), LEAST_MORE, (LOST,))


def find_flying(rows: Rows, camera: CameraFaults) -> NDArray[np.bool_]:
    """(b,) whether pixels at edges have a depth of no surface, given the camera's noise and bias."""
    z, d = rows["band_z"], rows["band_depth"]
    noise = camera.depth_noise(z, np.minimum(rows["band_cosine"], 1.0)) if camera.noise else np.zeros(len(z))
    near = z * (1 + camera.depth_scale) + camera.depth_offset + camera.depth_curve * z**2
    beyond = d - near > np.maximum(EDGE_SHARE * near, 5 * noise)
    return np.asarray((d > 0) & beyond & (rows["lonely"] >= np.maximum(0.01 * d, 3 * noise)))


def flying_kind(rows: Rows, camera: CameraFaults) -> Kind:
    """Pixels at depth edges with the depth of no surface; `camera` is the known depth bias and noise."""
    frame, distance, flying = rows.of("band"), rows["band"], find_flying(rows, camera)

    def logs_of(reach: float, share: float) -> Array:
        p = np.where(distance <= reach, np.clip(share, FLOOR_RATE, 0.999), FLOOR_RATE)
        return np.where(flying, np.log(p), np.log1p(-p))

    def fit(names: tuple[str, ...], frames: Frames, rival: str) -> SetFit:
        on, best = np.isin(frame, frames), (-np.inf, 0.0, 0.0)
        for reach in (1.0, 1.5, 2.0, 2.5, 3.0, 4.0) if names else ():
            near = on & (distance <= reach)
            share = float(flying[near].mean()) if near.any() else 0.0
            best = max(best, (float(logs_of(reach, share)[on].sum()), reach, share))
        _, reach, share = best
        logs = logs_of(reach, share)
        values = {"flying_share": share, "flying_reach": reach} if names else {}
        return SetFit(values, lambda some: _sum_by_frame(logs, frame, some), not names or share >= LEAST_FLYING)

    return Kind("flying pixels", ("flying_pixels",), fit, (), 0.0, (FLYING,))


def _sum_by_frame(logs: Array, frame: NDArray[np.int64], some: Frames) -> Array:
    """(some,) sums of the rows of each frame."""
    return np.asarray(np.bincount(frame, logs, int(max(some.max(initial=0), frame.max(initial=0))) + 1)[some])


def _cells(at: Array, side: int = 4) -> NDArray[np.int64]:
    """(n,) cell of a grid over the object's area in the picture."""
    if not len(at):
        return np.zeros(0, int)
    low, high = np.quantile(at, [0.01, 0.99], axis=0)
    k: NDArray[np.int64] = np.clip(((at - low) / np.maximum(high - low, 1e-9) * side).astype(np.int64), 0, side - 1)
    return k[:, 0] * side + k[:, 1]
