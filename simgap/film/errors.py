"""What the two films differ by, row by row, before and after: what maps are made of."""

from __future__ import annotations

import numpy as np

from freeart21.camera_faults import CameraFaults, with_values
from freeart21.se3 import Array
from simgap.film.counts import LEAST_FLYING, LEAST_HOLES
from simgap.film.found import Found
from simgap.film.library import GEOMETRY, design_of
from simgap.film.where import FilmMap, maps_of


def film_maps(found: Found) -> tuple[FilmMap, ...]:
    """Where the films part."""
    return maps_of(found.rows, errors_of(found))


def errors_of(found: Found) -> dict[str, tuple[Array, Array]]:
    """Before and after of every row, for the maps. Before: the asset's film with an ideal camera, to first order."""
    rows, camera = found.rows, found.camera
    z = rows["z"]
    geometry = _put_back(found)
    bias = camera.depth_scale * z + camera.depth_offset + camera.depth_curve * z * z
    out = {"depth error": (rows["error"] + geometry[0], rows["error"] - bias)}
    lost = np.isnan(rows["error"]).astype(float)
    holes = with_values(CameraFaults(), found.families[1].values)
    if lost.mean() >= LEAST_HOLES / 2:
        frame = rows.of("error")
        share = np.bincount(frame, lost) / np.maximum(np.bincount(frame), 1)
        out["holes"] = (lost - share[frame], lost - holes.lost(rows["measured_brightness"], rows["cosine"]))
    out["outline of the mask"] = (rows["mask_off"] + geometry[1], rows["mask_off"])
    out["outline of the depth"] = (rows["depth_off"] + geometry[2], rows["depth_off"])
    if found.families[2].before >= LEAST_FLYING / 2:
        flies = rows["flying"].astype(float)
        f = found.families[2].values
        told_share = np.where(rows["band"] <= f.get("flying_reach", 0.0), f.get("flying_share", 0.0), 0.0)
        out["pixels at edges"] = (flies - flies.mean(), flies - told_share)
    if found.drift is not None and found.drift.null is not None:
        share = np.array([f.share for f in rows.frames])[rows.of("stops")]
        d = found.drift
        curve = np.interp(share, np.linspace(0, 1, max(len(d.exposure), 1)), d.exposure or (0.0,))
        tone = np.interp(share, np.linspace(0, 1, max(len(d.gamma), 1)), d.gamma or (0.0,)) * rows["light"]
        stops = rows["stops"] - np.nanmedian(rows["stops"])
        then = rows["stops"] - curve - tone
        out["brightness of the picture"] = (stops, then - np.nanmedian(then))
    return out


def _put_back(found: Found) -> tuple[Array, Array, Array]:
    """What the geometry that the film was simulated with does to the rows, to first order."""
    rows, d = found.rows, found.design
    inner, mask, depth = np.isfinite(rows["error"]), np.isfinite(rows["mask_off"]), np.isfinite(rows["depth_off"])
    sizes = len(inner), len(mask), len(mask)
    out = tuple(np.zeros(n) for n in sizes)
    same = len(d.blocks[0].y) == int(inner.sum())
    blocks = d.blocks if same else design_of(rows, 1e-3, found.scene.placed.exact).blocks
    for effect in GEOMETRY:
        if effect.key != effect.name or effect.name in ("depth_scale", "depth_offset", "depth_curve"):
            continue
        for field, column in zip(effect.parameters, d.columns[effect.key], strict=True):
            value = float(getattr(found.simulated_with, field))
            for o, kept, b in zip(out, (inner, mask, depth), blocks, strict=True):
                o[kept] += value * b.columns[:, column]
    return out[0], out[1], out[2]
