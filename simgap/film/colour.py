"""Colour drift: exposure and gamma over the film, with the asset's own lighting free.

Rows are log2 of measured over simulated light. Every model has the lighting of static lamps and the asset's brightness
error; a drift is a curve over the film, and every frame has its own error in brightness and contrast.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from freeart21.se3 import Array
from simgap.film.choose import Kind
from simgap.film.effects import KNOTS, parameters_of
from simgap.film.geometry import Design, cosine_products, hat_functions, linear_kind, stack_columns
from simgap.film.linear import Block, LinearFit
from simgap.film.samples import Rows

GAP = "brightness of frames"
LEAST = {"exposure_drift": 0.1, "gamma_drift": 0.05}
"""Smallest range of a drift that is named, stops and 1: two clean films lit by SAPIEN's lamps had .009 and .065 stops
from lighting alone."""
LEAST_ROWS = 200
ROWS = 9000
_PLACES = "place in the picture, and time"
_FLOOR = (0.02, 0.01)
"""Noise of a row and of a frame, stops: 8 bits of a middle grey are a hundredth of a stop."""


def colour_design(rows: Rows) -> Design | None:
    """The colour rows as columns; None where there are too few."""
    usable = _rows_of(rows)
    if len(usable) < LEAST_ROWS:
        return None
    frame, light = rows.of("stops")[usable], light_of(rows)
    contrast = light - np.median(light)
    share = np.array([f.share for f in rows.frames])
    knots = hat_functions(share, np.linspace(0, 1, KNOTS))[frame]
    curve = knots[:, 1:] - knots[:, 1:].mean(0)
    at = rows["at"][usable] / max(float(np.abs(rows["at"]).max(initial=1.0)), 1.0)
    walking = (at[:, :, None] * knots[:, None, :]).reshape(len(usable), -1)
    of: dict[str, tuple[Array, ...]] = {
        "surface": (np.concatenate([_lighting(rows["normal"][usable]), hat_functions(light, 6)], 1),),
        "exposure_drift": (curve,),
        "gamma_drift": (curve * light[:, None],),
        _PLACES: (np.concatenate([cosine_products(at), walking], 1),),
    }
    columns, full, ridge = stack_columns(of, set(of), 3.0)
    own = np.column_stack([np.ones(len(usable)), contrast])
    return Design(
        (Block(rows["stops"][usable], full[0], own, frame, _FLOOR, 12.0),), columns, columns["surface"], ridge
    )


def _rows_of(rows: Rows) -> NDArray[np.int64]:
    """(n,) usable colour rows, at most about `ROWS`, evenly spaced."""
    usable = np.flatnonzero(np.isfinite(rows["stops"]) & (np.abs(rows["stops"]) < 6))
    return usable[:: max(1, len(usable) // ROWS)]


def light_of(rows: Rows) -> Array:
    """(n,) log2 of the simulated linear light in the rows of the design."""
    return rows["light"][_rows_of(rows)]


def colour_kind(design: Design, lit: bool) -> Kind:
    """Drifts of exposure and gamma.

    Where the asset's colours contain the film's lighting (`lit`), as a reconstruction's do, gamma is not fitted: it is
    confounded with lighting that moves over the surface.
    """
    effects = ("exposure_drift",) if lit else ("exposure_drift", "gamma_drift")
    return linear_kind("colours", design, effects, (_PLACES,), _values_of, _matters, (GAP,))


def _values_of(name: str, beta: Array) -> dict[str, float]:
    curve = np.array([0.0, *beta])
    return dict(zip(parameters_of(name), (curve - curve.mean()).tolist(), strict=True))


def _matters(design: Design, fit: LinearFit, names: tuple[str, ...]) -> bool:
    betas = {name: fit.beta[[fit.chosen.index(c) for c in design.columns[name]]] for name in names}
    return all(np.ptp(np.array([0.0, *beta])) >= LEAST[name] for name, beta in betas.items())


def _lighting(normal: Array) -> Array:
    """(n, 8) lighting of static lamps over normals (n, 3), to second order, without the constant.

    Nine such numbers give the light on a matt surface to 1 % (Ramamoorthi and Hanrahan 2001).
    """
    x, y, z = normal.T
    return np.stack([x, y, z, x * y, y * z, x * z, x * x - y * y, 3 * z * z - 1], -1)
