"""diagnostics.json and confidence/ of a result folder: a method's own quality measures, made without the truth.

Optional: no scorer reads them. Contents of the other result files (states and their standard deviations, poses, masks,
`seen`) are not repeated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.se3 import Array

SCHEMA = "freeart21/diagnostics/1"
FILE = "diagnostics.json"
MAX_BYTES = 32 << 20
"""Enough for a hundred thousand frames."""


@dataclass(frozen=True)
class Diagnostics:
    """How well n frames of both parts (reference, moving) agree with each other. NaN where nothing could be measured.

    Samples of a part are mapped from one frame into others by both poses, and compared with the pixels there.
    """

    pixels: Array
    """(n, 2) pixels of each part in the picture."""
    confidence: Array
    """(n, 2) mean probability, 0 to 1, of the labels given."""
    inliers: Array
    """(n, 2) share, 0 to 1, of samples within `gate_m` of the same part's surface."""
    outside: Array
    """(n, 2) share, 0 to 1, of samples that fall off the foreground."""
    residual_m: Array
    """(n, 2) metres: root mean square distance of inliers to the surface's planes, by the free poses."""
    jointed_residual_m: Array
    """(n, 2) metres: the same, by poses constrained by the joint."""
    gate_m: float
    """Metres: samples farther from the surface are no inliers."""
    footprint_m: float
    """Metres that a pixel covers at the object."""
    noise_m: float
    """Metres: standard deviation of depth, once planes are fitted to it."""
    diagonal_m: float
    """Metres: estimated size of the object."""
    peak_bytes: int | None = None
    """Peak memory of the process, if known."""
    confidence_maps: NDArray[np.uint8] | None = None
    """(n, height, width) probability, in 255ths, of the label of each pixel; 0 without a label."""
    unexplained: Array | None = None
    """(n,) share, 0 to 1, of the object's pixels that fit neither part's motion into other frames, if known."""
    other_motion_cost: Array | None = None
    """(n, 2) mean cost of each part's pixels under the other part's motion, where the joint moves; 0.5 is a misfit of a
    standard deviation. If known."""
    rival_distance: Array | None = None
    """(n,) distance, rad or m, to another state that explains the frame equally well; 0 without one. If known."""
    type_costs: Array | None = None
    """(2,) mean cost of a pixel under the joint, and under the best one of the other type; 0.5 is a misfit of a
    standard deviation. If known."""
    uncovered: Array | None = None
    """(n, 2) share, 0 to 1, of each part's pixels, off the object's outline and depth steps, where neither part's
    surface lies when joint and states pose them. In frames of any kind; the fields below: in frames that see both
    parts. If known."""
    spilled: Array | None = None
    """(n, 2) share, 0 to 1, of each part's visible surface, so posed, that lies off the object's mask."""
    off_surface: Array | None = None
    """(n, 2) share, 0 to 1, of each part's pixels where its surface is drawn at another depth than measured."""
    colour_residual: Array | None = None
    """(n, 2) median distance of the surface's colours to the picture's: CIELAB, lightness times 0.3."""
    extent_ratio: Array | None = None
    """(2,) diagonal of the box around each part's surface, over the largest extent of its pixels in any frame."""
    seen_share: Array | None = None
    """(2,) share, 0 to 1, of each part's surface by area where some frame measured depth on it, without detached
    pieces that were seen at one state only."""

    def __post_init__(self) -> None:
        for name, shape in _SHAPES.items():
            value, expected = getattr(self, name), tuple(len(self) if size is None else size for size in shape)
            if value is not None and np.shape(value) != expected:
                raise FreeArtError(f"diagnostics {name} has shape {np.shape(value)}, expected {expected}")
        maps = self.confidence_maps
        if maps is not None and (maps.ndim != 3 or len(maps) != len(self) or maps.dtype != np.uint8):
            raise FreeArtError(
                f"diagnostics confidence_maps has shape {maps.shape} {maps.dtype}, "
                f"expected ({len(self)}, height, width) uint8"
            )

    def __len__(self) -> int:
        return len(self.pixels)

    def exchanged(self) -> Diagnostics:
        """The same with reference and moving part exchanged."""
        turned = {
            name: getattr(self, name) for name, shape in _SHAPES.items() if shape[-1] == 2 and name != "type_costs"
        }
        return replace(self, **{name: value[..., ::-1] for name, value in turned.items() if value is not None})


_REQUIRED = ("pixels", "confidence", "inliers", "outside", "residual_m", "jointed_residual_m")
_SHAPES: dict[str, tuple[int | None, ...]] = {
    **dict.fromkeys(_REQUIRED, (None, 2)),
    **dict.fromkeys(("unexplained", "rival_distance"), (None,)),
    "type_costs": (2,),
    **dict.fromkeys(("other_motion_cost", "uncovered", "spilled", "off_surface", "colour_residual"), (None, 2)),
    **dict.fromkeys(("extent_ratio", "seen_share"), (2,)),
}
"""Of the arrays, in the order of the file; None is the number of frames."""
_SHARES = ("confidence", "inliers", "outside", "unexplained", "uncovered", "spilled", "off_surface", "seen_share")
_LENGTHS = ("gate_m", "footprint_m", "noise_m", "diagonal_m")


def diagnostics_to_json(diagnostics: Diagnostics) -> dict[str, Any]:
    """Plain values without the maps; arrays to six digits, null where nothing was measured."""
    arrays = {name: getattr(diagnostics, name) for name in _SHAPES}
    data = {name: _six_digits(np.asarray(value, float).tolist()) for name, value in arrays.items() if value is not None}
    lengths = {name: float(getattr(diagnostics, name)) for name in _LENGTHS}
    return {"schema": SCHEMA, **data, **lengths, "peak_bytes": diagnostics.peak_bytes}


def diagnostics_from_json(data: dict[str, Any], path: Path) -> Diagnostics:
    """What `diagnostics_to_json` wrote; raises FreeArtError naming `path`."""
    given = {name: shape for name, shape in _SHAPES.items() if name in _REQUIRED or data.get(name) is not None}
    arrays = {name: checked.numbers(data, name, shape, path, nullable=True) for name, shape in given.items()}
    for name, array in arrays.items():
        low, high = np.nanmin(array, initial=0.0), np.nanmax(array, initial=0.0)
        most = 1.0 if name in _SHARES else np.inf
        if low < 0 or high > most or not np.isfinite(high):
            raise FreeArtError(f"{path}: '{name}' reaches from {low:g} to {high:g}, expected 0 to {most:g}")
    lengths = {name: checked.number(data, name, path, 0.0, expected="metres, not negative") for name in _LENGTHS}
    peak = data.get("peak_bytes")
    if peak is not None and (not isinstance(peak, int) or isinstance(peak, bool) or peak < 0):
        raise FreeArtError(f"{path}: 'peak_bytes' is {peak!r}, expected a whole number or null")
    with checked.naming(path):
        return Diagnostics(**arrays, **lengths, peak_bytes=peak)  # type: ignore[arg-type]


def write_diagnostics(folder: Path, diagnostics: Diagnostics) -> None:
    """Write diagnostics.json and, when there are maps, confidence/."""
    atomic.write_json(folder / FILE, diagnostics_to_json(diagnostics))
    for i, image in enumerate(() if diagnostics.confidence_maps is None else diagnostics.confidence_maps):
        atomic.write_bytes(confidence_file(folder, i), checked.encode_png(image))


def read_diagnostics(folder: Path, n: int) -> Diagnostics | None:
    """The diagnostics in a result folder of `n` frames; None without any, FreeArtError when they are invalid.

    Without the maps, which `read_confidence` reads one by one.
    """
    path = Path(folder) / FILE
    if not checked.is_there(path):
        return None
    found = diagnostics_from_json(checked.read_json(path, SCHEMA, folder, MAX_BYTES), path)
    if len(found) != n:
        raise FreeArtError(f"{path} is of {len(found)} frames, expected {n} as in prediction.json")
    return found


def confidence_file(folder: Path, index: int) -> Path:
    """Path of the confidence map of frame `index`."""
    return Path(folder) / "confidence" / f"{index:05d}.png"


def read_confidence(folder: Path, index: int, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """The confidence map of frame `index`, which must be of `shape` (height, width); raises FreeArtError."""
    path = confidence_file(folder, index)
    found = checked.read_labels(path, Path(folder))
    if found.shape != shape:
        raise FreeArtError(
            f"{path} is {found.shape[1]} x {found.shape[0]}, expected {shape[1]} x {shape[0]} as the part masks"
        )
    return found


def _six_digits(value: Any) -> Any:
    """The numbers of nested lists."""
    if isinstance(value, list):
        return [_six_digits(entry) for entry in value]
    return float(f"{value:.6g}") if np.isfinite(value) else None
