"""Noise of single pixels, holes and flying pixels: what a depth picture has that no smooth shift explains.

Each is a small family of models with a formula for every pixel; frames judge them as they judge the geometry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from freeart21.camera_faults import SOFT, SOFT_RAD, falling
from freeart21.se3 import Array
from simgap.film.choose import Tried, smallest
from simgap.film.samples import Rows

WILD = 0.02
"""Share of the pixels that may be off by anything up to a metre: noise is Gaussian but for odd pixels. Not measured."""
LEAST_DEPTH = 5e-4
"""Share of the distance that noise must come to, as every error of the depth (`geometry.LEAST_DEPTH`)."""
LEAST_MORE = 0.05
"""Share of what the best set gains that another kind of holes must bring: creases lose pixels, too, and are darker."""
SMOOTH = 0.2
"""What pixels beside each other must differ by, as a share of what pixels four apart do, to be noise: of a smooth error
it is a sixteenth, of a Kinect's noise, which is smoothed, .7 (the foam tube, .25 against .35 mm)."""
LEAST_NOISE = 1.5
"""Floors that a pixel's noise must exceed to be named."""
LEAST_EXPONENT = 0.2
"""By which noise grows with distance or angle, to be named: less is hardly any. Not measured."""
LEAST_HOLES, LEAST_FLYING = 0.01, 0.1
"""Least share of the pixels (of the object; at its edges) that is named. A mask's rim is wrong for as many."""
FLOOR_RATE = 2e-3
"""Share of pixels that may be lost, or fly, in a film without fault."""
BINS = (30, 24)
"""Of brightness and of the angle of incidence, into which holes are counted."""


@dataclass(frozen=True)
class Family:
    """What was found of one kind."""

    kind: str
    """noise, holes or flying pixels."""
    chosen: tuple[str, ...]
    """Names of effects; none where nothing exceeds the floor."""
    values: dict[str, float]
    """Fields of `CameraFaults`."""
    rivals: tuple[tuple[str, ...], ...]
    tried: tuple[Tried, ...]
    null: Tried
    gains: Array
    """(confirming frames,) log predictive density gained."""
    before: float
    """Size on the confirming frames: of the noise in metres, else a share of the pixels."""
    after: float
    """What of it the model leaves."""
    floor: float
    spreads: dict[str, float]
    """Standard errors of `values`, from a fit to each of four groups of frames (jackknife)."""


Model = Callable[[NDArray[np.int64]], tuple[dict[str, float], Callable[[NDArray[np.int64]], Array]]]
"""Frames to fit -> values, and a function of frames -> log density of each."""


def chosen_of(
    kind: str,
    models: dict[tuple[str, ...], Model],
    nameless: dict[str, Model],
    split: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]],
    matters: Callable[[dict[str, float]], bool],
    size: Callable[[NDArray[np.int64], dict[str, float]], tuple[float, float]],
    floor: float,
    least_share: float = 0.0,
) -> Family:
    """The smallest of `models` within one standard error of the best on the frames that choose."""
    fit_on, choose_on, confirm_on = split
    made = {names: model(fit_on) for names, model in models.items()}
    tried = [
        Tried(names, len(names) + len(values), judged(choose_on))
        for names, (values, judged) in made.items()
        if not names or matters(values)
    ]
    null = next(t for t in tried if not t.names)
    first, alike = smallest(tried, least_share)
    for name, model in nameless.items():
        tried.append(Tried((name,), 0, model(fit_on)[1](choose_on), nameless=True))
    values, judged = made[first.names]
    gains = judged(confirm_on) - made[()][1](confirm_on)
    spreads: dict[str, float] = {}
    if first.names:
        groups = [np.delete(fit_on, np.arange(g, len(fit_on), 4)) for g in range(4)]
        again = [models[first.names](g)[0] for g in groups if len(g) >= 2]
        spreads = {name: float(np.sqrt(3) * np.std([a[name] for a in again])) for name in values if len(again) == 4}
    before, after = size(confirm_on, values)
    ordered = tuple(sorted(tried, key=lambda t: -t.mean))
    return Family(
        kind, first.names, values if first.names else {}, tuple(t.names for t in alike), ordered, null, gains, before,
        after, floor, spreads,
    )  # fmt: skip


# --- noise ------------------------------------------------------------------------------------------------------------


def noise(rows: Rows, split: tuple[NDArray[np.int64], ...], floor: float) -> Family:
    """Noise of single pixels, by the differences of pixels near each other, which poses and smooth shapes do not touch.

    `floor` is what the step of the measured depth and the asset's own roughness make of it, metres.
    """
    pair = rows["pair"]
    kept = np.flatnonzero(np.isfinite(pair))
    frame, e, z, cosine, at = (
        rows.of("pair")[kept], pair[kept], rows["z"][kept], np.maximum(rows["cosine"][kept], 0.05), rows["at"][kept],
    )  # fmt: skip
    middle = float(np.median(z)) if len(z) else 1.0
    near = np.abs(rows["near"][np.isfinite(rows["near"])])
    beside = float(np.sqrt(np.mean(np.minimum(near, np.quantile(near, 0.95)) ** 2))) if len(near) else 0.0
    growth, grazing = np.log(np.maximum(z, 1e-6) / middle), -np.log(cosine)
    names = ("noise_growth", "noise_grazing")

    def model(which: tuple[int, ...]) -> Model:
        def fit(frames: NDArray[np.int64]) -> tuple[dict[str, float], Callable[[NDArray[np.int64]], Array]]:
            on = np.isin(frame, frames)
            features = np.stack([np.ones(len(e)), growth, grazing], -1)[:, [0, *which]]
            beta = _scale_fit(e[on], features[on], floor)
            values = {"noise": float(np.exp(beta[0])), "noise_at": middle}
            values |= {names[k - 1]: float(np.clip(b, -4, 8)) for k, b in zip(which, beta[1:], strict=True)}
            scale = np.sqrt(floor**2 + np.exp(2 * np.clip(features @ beta, -30, 5)))
            return values, lambda some: _summed(_noise_log(e, scale), frame, some)

        return fit

    def quiet(frames: NDArray[np.int64]) -> tuple[dict[str, float], Callable[[NDArray[np.int64]], Array]]:
        return {}, lambda some: _summed(_noise_log(e, np.full(len(e), floor)), frame, some)

    def placed(frames: NDArray[np.int64]) -> tuple[dict[str, float], Callable[[NDArray[np.int64]], Array]]:
        """A noise of its own for every place of the picture."""
        cell = _cells(at, 4)
        on = np.isin(frame, frames)
        all_ = _robust(e[on])
        size = np.array([_robust(e[on & (cell == c)], all_) for c in range(16)])
        scale = np.sqrt(floor**2 + size[cell] ** 2)
        return {}, lambda some: _summed(_noise_log(e, scale), frame, some)

    models: dict[tuple[str, ...], Model] = {
        (): quiet,
        ("axial_noise",): model(()),
        ("axial_noise", "noise_growth"): model((1,)),
        ("axial_noise", "noise_grazing"): model((2,)),
        ("axial_noise", "noise_growth", "noise_grazing"): model((1, 2)),
    }

    def size(frames: NDArray[np.int64], values: dict[str, float]) -> tuple[float, float]:
        on = np.isin(frame, frames)
        had = _robust(e[on])
        if not values:
            return had, had
        told = values["noise"] * np.exp(
            values.get("noise_growth", 0.0) * growth[on] + values.get("noise_grazing", 0.0) * grazing[on]
        )
        simulated = _robust(np.random.default_rng(5).normal(size=int(on.sum())) * np.hypot(told, floor))
        return had, abs(had - simulated)

    return chosen_of(
        "noise", models, {"place in the picture": placed}, _three(split),
        lambda v: v["noise"] >= max(LEAST_NOISE * floor, LEAST_DEPTH * middle)
        and beside >= SMOOTH * v["noise"]
        and abs(v.get("noise_growth", 1.0)) >= LEAST_EXPONENT
        and v.get("noise_grazing", 1.0) >= LEAST_EXPONENT,
        size, floor,
    )  # fmt: skip


def _scale_fit(e: Array, features: Array, floor: float) -> Array:
    """Coefficients of the log scale of `e` (n,), which has the noise `floor` besides, by maximum likelihood."""
    step = max(1, len(e) // 8000)
    e, features = e[::step], features[::step]
    begin = np.zeros(features.shape[1])
    begin[0] = np.log(max(_robust(e), floor, 1e-7))

    def loss(beta: Array) -> float:
        scale = np.sqrt(floor**2 + np.exp(2 * np.clip(features @ beta, -30, 5)))
        return float(-_noise_log(e, scale).mean() + 1e-3 * (beta[1:] ** 2).sum())

    return np.asarray(minimize(loss, begin, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-6}).x)


def _noise_log(e: Array, scale: Array) -> Array:
    """Log density of noise with standard deviation `scale`, metres."""
    bell = 0.39894 * np.exp(-0.5 * (e / scale) ** 2) / scale
    return np.asarray(np.log((1 - WILD) * bell + WILD))


def _robust(e: Array, otherwise: float = 0.0) -> float:
    """Standard deviation by the median of sizes."""
    return float(np.median(np.abs(e)) * 1.4826) if len(e) > 20 else otherwise


# --- holes ------------------------------------------------------------------------------------------------------------


def holes(rows: Rows, split: tuple[NDArray[np.int64], ...]) -> Family:
    """Pixels without depth inside the object: anywhere, on dark surfaces, on grazing ones."""
    lost = np.isnan(rows["error"])
    frame, bright, angle, at = (
        rows.of("error"), rows["measured_brightness"], np.arccos(np.clip(rows["cosine"], 0, 1)), rows["at"],
    )  # fmt: skip
    b = np.minimum((bright * BINS[0]).astype(int), BINS[0] - 1)
    a = np.minimum((angle / (np.pi / 2) * BINS[1]).astype(int), BINS[1] - 1)
    n = len(rows.frames)
    count, gone = np.zeros((n, *BINS)), np.zeros((n, *BINS))
    np.add.at(count, (frame, b, a), 1)
    np.add.at(gone, (frame, b, a), lost)
    light = (np.arange(BINS[0]) + 0.5) / BINS[0]
    slope = (np.arange(BINS[1]) + 0.5) / BINS[1] * np.pi / 2

    def rate(values: dict[str, float]) -> Array:
        kept = np.full(BINS, 1 - values.get("holes", 0.0)) * (1 - FLOOR_RATE)
        if "dark_share" in values:
            kept = kept * (1 - values["dark_share"] * falling((values["dark_level"] - light) / SOFT))[:, None]
        if "grazing_share" in values:
            kept = kept * (1 - values["grazing_share"] * falling((slope - values["grazing_angle"]) / SOFT_RAD))[None]
        return np.clip(1 - kept, FLOOR_RATE, 1 - 1e-3)

    def judged(p: Array) -> Callable[[NDArray[np.int64]], Array]:
        logs = gone * np.log(p) + (count - gone) * np.log(1 - p)
        return lambda some: logs[some].sum((1, 2))

    def model(effects: tuple[str, ...]) -> Model:
        parameters = [p for e in effects for p in _HOLES[e]]

        def fit(frames: NDArray[np.int64]) -> tuple[dict[str, float], Callable[[NDArray[np.int64]], Array]]:
            c, g = count[frames].sum(0), gone[frames].sum(0)

            def loss(x: Array) -> float:
                p = rate(_held(parameters, x))
                return float(-(g * np.log(p) + (c - g) * np.log(1 - p)).sum() / max(c.sum(), 1))

            best = min(
                (_begun(loss, parameters, level, tilt) for level in _LEVELS for tilt in _TILTS), key=lambda r: r.fun
            )
            best = minimize(loss, best.x, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-7, "maxiter": 600})
            values = _held(parameters, best.x)
            return values, judged(rate(values))

        return fit

    def free(key: NDArray[np.int64], cells: int) -> Model:
        """A share of its own for every cell."""

        def fit(frames: NDArray[np.int64]) -> tuple[dict[str, float], Callable[[NDArray[np.int64]], Array]]:
            on = np.isin(frame, frames)
            p = (np.bincount(key[on], lost[on], cells) + 0.5) / (np.bincount(key[on], minlength=cells) + 1 / FLOOR_RATE)
            logs = np.where(lost, np.log(p[key]), np.log1p(-np.minimum(p[key], 1 - 1e-3)))
            return {}, lambda some: _summed(logs, frame, some)

        return fit

    sets: list[tuple[str, ...]] = [
        ("holes",), ("dark_holes",), ("grazing_holes",), ("dark_holes", "grazing_holes"), ("holes", "dark_holes"),
        ("holes", "grazing_holes"),
    ]  # fmt: skip
    models: dict[tuple[str, ...], Model] = {(): lambda frames: ({}, judged(rate({})))}
    models |= {s: model(s) for s in sets}

    dark_end = float(np.quantile(bright, 0.95)) if len(bright) else 1.0
    flat_end = float(np.quantile(angle, 0.05)) if len(angle) else 0.0

    def matters(values: dict[str, float]) -> bool:
        """Every effect of the set takes its share of all pixels, and leaves others alone: else it is of anywhere."""
        total = count.sum(0)
        alone = [{p: v for p, v in values.items() if p in _HOLES[e]} for e in _HOLES]
        shares = [float((total * (rate(v) - rate({}))).sum() / max(total.sum(), 1)) for v in alone if v]
        inside = values.get("dark_level", 0.0) < dark_end and values.get("grazing_angle", 2.0) > flat_end
        return inside and min(shares) >= LEAST_HOLES

    def size(frames: NDArray[np.int64], values: dict[str, float]) -> tuple[float, float]:
        total, g = count[frames].sum(0), gone[frames].sum(0)
        had = float(g.sum() / max(total.sum(), 1))
        off = np.abs(g - total * rate(values)).sum() / max(total.sum(), 1) if values else had
        return had, float(off)

    grid = _cells(at, 4)
    nameless = {"place in the picture": free(grid, 16), "part": free(rows["part"], 3)}
    return chosen_of("holes", models, nameless, _three(split), matters, size, LEAST_HOLES, LEAST_MORE)


_HOLES: dict[str, tuple[str, ...]] = {
    "holes": ("holes",),
    "dark_holes": ("dark_share", "dark_level"),
    "grazing_holes": ("grazing_share", "grazing_angle"),
}
_LEVELS, _TILTS = (0.08, 0.2, 0.35, 0.5), tuple(np.radians((45.0, 60.0, 75.0)))
_CEILING = {"dark_level": 0.8, "grazing_angle": np.pi / 2}


def _held(parameters: list[str], x: Array) -> dict[str, float]:
    """Parameters of unbounded numbers: each between 0 and its ceiling."""
    return {p: float(_CEILING.get(p, 0.995) * falling(v)) for p, v in zip(parameters, x, strict=True)}


def _begun(loss: Callable[[Array], float], parameters: list[str], level: float, tilt: float) -> Any:
    from types import SimpleNamespace

    share = {"holes": 0.02, "dark_share": 0.7, "grazing_share": 0.7, "dark_level": level / 0.8,
             "grazing_angle": tilt / (np.pi / 2)}  # fmt: skip
    x = np.array([np.log(share[p] / (1 - share[p])) for p in parameters])
    return SimpleNamespace(x=x, fun=loss(x))


# --- flying pixels ----------------------------------------------------------------------------------------------------


def flying(rows: Rows, split: tuple[NDArray[np.int64], ...]) -> Family:
    """Pixels at depth edges whose depth is that of no surface."""
    frame, distance, flies = rows.of("band"), rows["band"], rows["flying"]

    def model(frames: NDArray[np.int64]) -> tuple[dict[str, float], Callable[[NDArray[np.int64]], Array]]:
        on = np.isin(frame, frames)
        best: tuple[float, float, float] = (-np.inf, 1.0, 0.0)
        for reach in (1.0, 1.5, 2.0, 2.5, 3.0, 4.0):
            near = on & (distance <= reach)
            share = float(flies[near].mean()) if near.any() else 0.0
            value = float(_logs(reach, share)[on].sum())
            best = max(best, (value, reach, share))
        _, reach, share = best
        return {"flying_share": share, "flying_reach": reach}, lambda some: _summed(_logs(reach, share), frame, some)

    def _logs(reach: float, share: float) -> Array:
        p = np.where(distance <= reach, np.clip(share, FLOOR_RATE, 0.999), FLOOR_RATE)
        return np.where(flies, np.log(p), np.log1p(-p))

    def size(frames: NDArray[np.int64], values: dict[str, float]) -> tuple[float, float]:
        on = np.isin(frame, frames) & (distance <= values.get("flying_reach", 2.0))
        had = float(flies[on].mean()) if on.any() else 0.0
        return had, abs(had - values["flying_share"]) if values else had

    models: dict[tuple[str, ...], Model] = {
        (): lambda frames: ({}, lambda some: _summed(_logs(0.0, 0.0), frame, some)),
        ("flying_pixels",): model,
    }
    return chosen_of(
        "flying pixels", models, {}, _three(split), lambda v: v["flying_share"] >= LEAST_FLYING, size, LEAST_FLYING
    )


# --- shared -----------------------------------------------------------------------------------------------------------


def _summed(logs: Array, frame: NDArray[np.int64], some: NDArray[np.int64]) -> Array:
    return np.asarray(np.bincount(frame, logs, int(max(some.max(initial=0), frame.max(initial=0))) + 1)[some])


def _cells(at: Array, side: int) -> NDArray[np.int64]:
    """(n,) cell of a grid over where the object ever is."""
    if not len(at):
        return np.zeros(0, int)
    low, high = np.quantile(at, [0.01, 0.99], axis=0)
    k: NDArray[np.int64] = np.clip(((at - low) / np.maximum(high - low, 1e-9) * side).astype(np.int64), 0, side - 1)
    return k[:, 0] * side + k[:, 1]


def _three(
    split: tuple[NDArray[np.int64], ...],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    return split[0], split[1], split[2]
