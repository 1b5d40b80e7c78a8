"""Gaussians as the PLY file that 3D Gaussian splatting viewers read (Kerbl et al. 2023), with a part weight each.

Binary, little-endian, 32-bit floats: `x y z nx ny nz f_dc_0..2 opacity scale_0..2 rot_0..3 part_weight`; `opacity` is a
logit, `scale_*` are natural logarithms, `rot_*` is w first, and the colour is `0.5 + SH_0 * f_dc`. Viewers find
properties by name; they skip part_weight, `supposed` (1 on surface that nobody saw; last, where it is known) and the
comments, which hold the light.
"""

from __future__ import annotations

import os
from dataclasses import replace
from io import BufferedReader
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.mesh_file import MAX_PLY_BYTES, read_header
from freeart21.gaussians import LIGHT_TERMS, Gaussians
from freeart21.se3 import Array, Floats, rotation_from_wxyz

GAUSSIANS = "gaussians.ply"
"""The file in a result or asset folder."""
SH_0 = 0.28209479177387814
"""The spherical harmonic of degree 0, which scales colours in 3DGS files."""
MAX_GAUSSIANS = 4_000_000
MAX_HEADER_BYTES = 16 << 10
"""Our files have at most 2,500; other readers look for the header's end in the first 8 to 10 kB."""
FAINTEST = 1e-9
"""Opacities stay this far from 0 and 1, whose logits are infinite: 1 is read back as 1, 0 as this."""
SMALLEST = 1e-12
"""Smallest scale, metres: the logarithm of 0 is infinite."""
_LIGHT = "comment freeart21/light "
"""Precedes the three numbers of one coefficient, in the order of `spherical_harmonics`."""
_NAMES = (
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3", "part_weight"),
)
_SUPPOSED = "supposed"
_OPTIONAL = ("nx", "ny", "nz", "part_weight")


def write_gaussians(path: Path, gaussians: Gaussians) -> None:
    """Write `gaussians` to `path`, whole or not at all.

    Precision is that of 32-bit floats, with the limits FAINTEST and SMALLEST. Colours are those in mean light; `light`
    is written into comments. Raises CannotWrite.
    """
    opacity = np.clip(gaussians.opacities.astype(float), FAINTEST, 1 - FAINTEST)
    columns = [
        gaussians.means,
        gaussians.normals,
        (gaussians.colours.astype(float) - 0.5) / SH_0,
        np.log(opacity) - np.log1p(-opacity),
        np.log(np.maximum(gaussians.scales.astype(float), SMALLEST)),
        gaussians.quaternions,
        gaussians.part_weights,
    ]
    names: tuple[str, ...] = _NAMES
    if gaussians.supposed is not None:
        columns.append(gaussians.supposed)
        names += (_SUPPOSED,)
    table = np.column_stack(columns).astype("<f4")
    light = [] if gaussians.light is None else gaussians.light.tolist()
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment metres, joint state zero; part_weight 1 is the reference part's, 0 the moving part's",
        *(_LIGHT + " ".join(f"{value:.9g}" for value in term) for term in light),
        f"element vertex {len(table)}",
        *(f"property float {name}" for name in names),
        "end_header\n",
    ]
    atomic.write_bytes(path, "\n".join(header).encode() + table.tobytes())


def read_gaussians(path: Path, needs_parts: bool = False, root: Path | None = None) -> Gaussians:
    """The Gaussians in `path`, from any 3DGS writer: bounded, checked, nothing executed.

    Properties can be in any order; unknown ones (`f_rest_*`, which depend on the view) are ignored; colours are clipped
    to 0..1. Without normals, or where they are zero, a Gaussian's thinnest axis is its normal, pointing away from the
    median of all. Without part_weight all belong to the reference part.

    Raises FreeArtError on any other file, and with `needs_parts` when part_weight is missing.
    """
    try:
        with checked.open_file(path, MAX_PLY_BYTES, root) as file:
            table, light = _table(file)
        with np.errstate(over="ignore"):  # numbers beyond 32-bit floats become infinite, and are refused
            return _gaussians(table, light, needs_parts)
    except (ValueError, IndexError, OverflowError, OSError, FreeArtError) as error:
        raise FreeArtError(f"{path} is not a readable PLY file of Gaussians: {error}") from error


def _table(file: BufferedReader) -> tuple[NDArray[np.void], Floats | None]:
    """The rows of the vertices, and the light in the comments; ValueError when the file is invalid."""
    header = read_header(file.read(MAX_HEADER_BYTES))
    if header.encoding != "binary_little_endian":
        raise ValueError(f"its format is {header.encoding}, expected binary_little_endian")
    if not header.elements or header.elements[0][0] != "vertex":
        raise ValueError("its first element is not vertex")
    dtype, (_, count, _) = header.dtype(0), header.elements[0]
    if count > MAX_GAUSSIANS:
        raise ValueError(f"it has {count} Gaussians, at most {MAX_GAUSSIANS} are read")
    known = dtype.names or ()
    missing = [name for name in _NAMES if name not in known and name not in _OPTIONAL]
    if missing:
        has = checked.shorten(", ".join(known))
        raise ValueError(f"its vertices have no {', '.join(missing)}; their properties are {has}")
    there = max(0, os.fstat(file.fileno()).st_size - header.body_at) // dtype.itemsize
    if there < count:
        raise ValueError(f"it ends after {there} of {count} Gaussians")
    file.seek(header.body_at)
    return np.frombuffer(file.read(count * dtype.itemsize), dtype, count), _light(header.comments)


def _light(lines: list[str]) -> Floats | None:
    found = [line.removeprefix(_LIGHT).split() for line in lines if line.startswith(_LIGHT)]
    if not found:
        return None
    if len(found) not in LIGHT_TERMS or any(len(term) != 3 for term in found):
        raise ValueError(f"its light has {len(found)} lines, expected {', '.join(map(str, LIGHT_TERMS))} of 3 numbers")
    light = np.array([[float(value) for value in term] for term in found], np.float32)
    if not np.isfinite(light).all():
        raise ValueError("its light is not all finite")
    return light


def _gaussians(table: NDArray[np.void], light: Floats | None, needs_parts: bool) -> Gaussians:
    names = table.dtype.names or ()

    def columns(*wanted: str) -> Array:
        values = np.stack([table[name].astype(float) for name in wanted], -1)
        bad = ~np.isfinite(values)
        if bad.any():
            row, column = np.argwhere(bad)[0]
            raise ValueError(f"{wanted[column]} of Gaussian {row} is {values[row, column]}, expected a finite number")
        return values

    quaternions = columns("rot_0", "rot_1", "rot_2", "rot_3")
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    if not (lengths > 0).all():
        raise ValueError(f"the quaternion of Gaussian {int((lengths <= 0).argmax())} is zero")
    quaternions /= lengths
    logits, logarithms = columns("opacity")[:, 0], columns("scale_0", "scale_1", "scale_2")
    if logarithms.max(initial=0) > np.log(1e6):
        raise ValueError(f"scale {np.exp(min(logarithms.max(), 700.0)):.3g} m, expected logarithms of metres below 1e6")
    means, scales = columns("x", "y", "z"), np.maximum(np.exp(logarithms), SMALLEST)
    weights = np.ones(len(table))
    if "part_weight" in names:
        weights = columns("part_weight")[:, 0]
        if weights.min(initial=0) < 0 or weights.max(initial=0) > 1:
            worst = float(weights[np.abs(weights - 0.5).argmax()])
            raise ValueError(f"a part_weight is {worst:.6g}, expected 0 (moving part) to 1 (reference part)")
    elif needs_parts:
        raise ValueError("it has no part_weight (1 reference part, 0 moving part), so which part moves is not known")
    given = columns("nx", "ny", "nz") if {"nx", "ny", "nz"} <= set(names) else np.zeros_like(means)
    colours = np.clip(0.5 + SH_0 * columns("f_dc_0", "f_dc_1", "f_dc_2"), 0, 1)
    normals = _normals(given, means, quaternions, scales)
    values = (means, quaternions, scales, 1 / (1 + np.exp(-logits)), colours, weights, normals)
    supposed = columns(_SUPPOSED)[:, 0] > 0.5 if _SUPPOSED in names else None
    return replace(Gaussians(*(a.astype(np.float32) for a in values)), light=light, supposed=supposed)


def _normals(
    given: Array,
    means: Array,
    quaternions: Array,
    scales: Array,
) -> Array:
    """(N, 3) unit normals as given, or where these are zero the thinnest axes, pointing away from the median point."""
    lengths = np.linalg.norm(given, axis=1)
    lost = lengths == 0
    normals = given / np.where(lost, 1, lengths)[:, None]
    if lost.any():
        R = rotation_from_wxyz(quaternions[lost])
        thin = np.take_along_axis(R, scales[lost].argmin(1)[:, None, None], 2)[..., 0]
        inward = np.einsum("ni,ni->n", thin, means[lost] - np.median(means, 0)) < 0
        normals[lost] = np.where(inward[:, None], -thin, thin)
    return normals
