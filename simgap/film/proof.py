"""The gap between a camera's simulated film and the measured one.

It takes a camera's numbers as in camera.json, however they were found.
"""

from __future__ import annotations

import numpy as np

from freeart21.camera_faults import CameraFaults, drift_at
from freeart21.se3 import Array
from simgap.film import colour, geometry, pixel_faults
from simgap.film.linear import Block, fit_blocks
from simgap.film.samples import Rows
from simgap.verdict import root_mean_square

ROUNDED_PX = 0.41
"""RMS difference of two outlines that are both rounded to whole pixels: 1 / sqrt(6)."""
UNITS = {
    **dict(zip(geometry.GAPS, ("m", "px", "px"), strict=True)),
    pixel_faults.NOISE: "m",
    pixel_faults.LOST: "1",
    pixel_faults.FLYING: "1",
    colour.GAP: "stops",
}
"""Of every gap."""


def measure_gaps(
    rows: Rows, camera: CameraFaults, known: CameraFaults, quiet: float, depth_unit: float
) -> dict[str, float]:
    """RMS of measured less simulated quantities (shares, for holes and flying pixels).

    Args:
        rows: about the film simulated with the geometry and timing of `camera`.
        camera: whose gap it is.
        known: known depth bias and noise, for finding flying pixels.
        quiet: noise floor of a pixel, metres.
        depth_unit: quantisation of the measured depth, metres.
    """
    inner, *outlines = geometry.make_design(rows, depth_unit, True, CameraFaults()).blocks
    z = rows["z"][np.isfinite(rows["error"])]
    bias = camera.depth_scale * z + camera.depth_offset + camera.depth_curve * z**2
    residuals = (inner.y - bias, *(b.y for b in outlines))
    sizes = dict(zip(geometry.GAPS, map(_winsorised_rms, residuals), strict=True))
    pairs = np.isfinite(rows["pair"])
    had = pixel_faults.robust_deviation(rows["pair"][pairs])
    spread = np.hypot(camera.depth_noise(rows["z"][pairs], rows["cosine"][pairs]), quiet)
    simulated = np.random.default_rng(5).normal(size=len(spread)) * spread if camera.noise else np.zeros(len(spread))
    sizes[pixel_faults.NOISE] = abs(had - pixel_faults.robust_deviation(simulated))
    every, gone = (c.sum(0) for c in pixel_faults.count_holes(rows))
    off = (gone - every * pixel_faults.hole_rate(camera)).reshape(6, -1, 6, every.shape[1] // 6).sum((1, 3))
    sizes[pixel_faults.LOST] = float(np.abs(off).sum() / max(every.sum(), 1))  # in wide bins, less noisy
    near = rows["band"] <= (known.flying_reach or 2.0)
    flying = float(pixel_faults.find_flying(rows, known)[near].mean()) if near.any() else 0.0
    sizes[pixel_faults.FLYING] = abs(flying - camera.flying_share)
    design = colour.colour_design(rows)
    if design is not None:
        sizes[colour.GAP] = _brightness(rows, design, camera)
    return sizes


def floors(rows: Rows, best: CameraFaults, quiet: float, depth_unit: float) -> dict[str, float]:
    """Resolution of the comparison: quantisation, and noise once it is named; units as the gaps."""
    depth = float(np.hypot(geometry.depth_floor(float(np.median(rows["z"])), depth_unit), best.noise))
    sizes = (depth, ROUNDED_PX, ROUNDED_PX, quiet, pixel_faults.LEAST_HOLES, pixel_faults.LEAST_FLYING)
    return dict(zip(UNITS, (*sizes, colour.LEAST["exposure_drift"] / 2), strict=True))


def _winsorised_rms(r: Array) -> float:
    """RMS with sizes limited to the 95th percentile."""
    return root_mean_square(np.minimum(np.abs(r), np.quantile(np.abs(r), 0.95))) if len(r) else 0.0


def _brightness(rows: Rows, design: geometry.Design, camera: CameraFaults) -> float:
    """RMS brightness error of whole frames, stops, without their median."""
    (block,) = design.blocks
    share = np.array([f.share for f in rows.frames])
    exposure, gamma = (np.array([drift_at(knots, s) for s in share]) for knots in (camera.exposure, camera.gamma))
    drift = exposure[block.frame] + gamma[block.frame] * colour.light_of(rows)
    block = Block(block.y - drift, block.columns, block.own, block.frame, block.least, block.span)
    r = fit_blocks([block], design.free, design.ridge).residual(block)
    off = np.array([np.median(each) for each in np.split(r, block.starts[1:])])
    return root_mean_square(off - np.median(off))
