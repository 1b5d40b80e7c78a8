"""Tables that others printed, as data: set beside ours as published, never ranked with them.

Other objects, other videos, and definitions that the printed words do not fix: see docs/protocols.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

PAPER = "FreeArtGS (CVPR 2026, arXiv 2603.22102)"
FREEART21 = "FreeArt-21"
V2A_S = "Video2Articulation-S"
REAL = "six real objects (FreeArtGS)"


@dataclass(frozen=True)
class PublishedRow:
    """One line of a printed table: a method over all objects of a data set whose joint is of one type."""

    method: str
    protocol: str
    """The protocol of ours whose definitions come nearest to those that the numbers were computed by."""
    dataset: str
    """What it was measured on: other objects than ours."""
    group: Literal["revolute", "prismatic", "all"]
    values: dict[str, tuple[float, float | None]]
    """Metric id of the protocol to mean and sample standard deviation (None: not printed), in the metric's unit."""
    source: str
    """Where it was printed."""


Value = tuple[float, float | None]
_JOINT = ("axis", "position", "state")
_SURFACES = ("cd_w", "cd_m", "cd_s")


def _rows(
    protocol: str,
    dataset: str,
    group: Literal["revolute", "prismatic", "all"],
    ids: tuple[str, ...],
    source: str,
    printed: dict[str, tuple[Value | None, ...]],
) -> tuple[PublishedRow, ...]:
    """A row for each printed line: method to the values of `ids`, None where the table has a dash."""
    return tuple(
        PublishedRow(
            method,
            protocol,
            dataset,
            group,
            {id: value for id, value in zip(ids, line, strict=True) if value is not None},
            f"{PAPER}, {source}",
        )
        for method, line in printed.items()
    )


_MAIN = (*_JOINT, *_SURFACES, "psnr")
_TYPED: dict[Literal["revolute", "prismatic"], dict[str, tuple[Value | None, ...]]] = {
    "revolute": {
        "Articulate-Anything": ((42.00, 46.48), (59.38, 62.19), None, None, None, None, None),
        "Video2Articulation": (
            (20.00, 28.81),
            (16.31, 28.78),
            (27.37, 19.06),
            (2.29, 3.40),
            (10.74, 16.35),
            (1.87, 1.59),
            None,
        ),
        "FreeArtGS": (
            (1.04, 1.03),
            (0.29, 0.36),
            (1.43, 1.20),
            (0.14, 0.13),
            (0.28, 0.36),
            (0.97, 2.69),
            (24.02, 3.15),
        ),
        "FreeArtGS w/o Smooth Loss": (
            (28.01, 29.23),
            (17.73, 30.79),
            (18.74, 20.96),
            (5.72, 7.39),
            (14.37, 15.89),
            (5.64, 9.17),
            (10.60, 4.61),
        ),
        "FreeArtGS w/o Init Loss": (
            (9.35, 13.50),
            (19.58, 39.17),
            (14.64, 19.90),
            (0.75, 0.90),
            (1.90, 3.11),
            (1.14, 2.60),
            (13.07, 7.26),
        ),
        "FreeArtGS w/o Noise Resistance": (
            (4.75, 7.83),
            (2.22, 6.89),
            (1.30, 1.09),
            (0.17, 0.15),
            (0.48, 0.79),
            (1.10, 2.72),
            (22.65, 3.13),
        ),
        "FreeArtGS w/o Blended Rendering": (
            (1.72, 2.38),
            (1.88, 6.23),
            (1.88, 2.54),
            (0.12, 0.07),
            (0.34, 0.52),
            (1.05, 2.61),
            (22.23, 2.64),
        ),
    },
    "prismatic": {
        "Articulate-Anything": ((45.00, 49.30), None, None, None, None, None, None),
        "Video2Articulation": (
            (18.47, 22.83),
            None,
            (13.98, 21.47),
            (1.51, 2.23),
            (8.41, 14.57),
            (5.31, 15.37),
            None,
        ),
        "FreeArtGS": (
            (1.85, 2.75),
            None,
            (0.90, 0.53),
            (0.41, 0.22),
            (0.67, 0.34),
            (0.30, 0.13),
            (22.92, 2.65),
        ),
        "FreeArtGS w/o Smooth Loss": (
            (26.97, 23.75),
            None,
            (46.91, 58.06),
            (8.21, 11.16),
            (11.82, 11.37),
            (10.16, 13.62),
            (12.63, 6.46),
        ),
        "FreeArtGS w/o Init Loss": (
            (28.72, 27.83),
            None,
            (38.31, 38.81),
            (22.3, 50.18),
            (23.73, 44.37),
            (21.62, 45.33),
            (13.86, 4.48),
        ),
        "FreeArtGS w/o Noise Resistance": (
            (11.90, 26.93),
            None,
            (16.78, 38.86),
            (0.87, 1.02),
            (5.85, 13.24),
            (0.90, 1.50),
            (20.18, 3.36),
        ),
        "FreeArtGS w/o Blended Rendering": (
            (2.04, 3.01),
            None,
            (0.97, 0.39),
            (0.45, 0.24),
            (0.50, 0.42),
            (0.28, 0.13),
            (20.24, 2.64),
        ),
    },
}
_ROBUSTNESS: dict[Literal["revolute", "prismatic"], dict[str, tuple[Value | None, ...]]] = {
    "revolute": {
        "FreeArtGS, 2% Depth Noise": (
            (1.41, 1.49),
            (0.51, 0.58),
            (1.22, 1.27),
            (0.23, 0.30),
            (0.30, 0.27),
            (1.05, 2.47),
            (23.52, 4.65),
        ),
        "FreeArtGS, CoTracker3": (
            (0.88, 0.84),
            (0.46, 0.86),
            (1.68, 1.30),
            (0.79, 2.19),
            (0.80, 1.08),
            (1.47, 2.43),
            (23.87, 4.94),
        ),
        "FreeArtGS, DINOv2": (
            (1.64, 1.22),
            (0.32, 0.47),
            (1.21, 0.77),
            (0.11, 0.11),
            (0.28, 0.27),
            (1.04, 2.52),
            (23.74, 4.41),
        ),
    },
    "prismatic": {
        "FreeArtGS, 2% Depth Noise": (
            (1.86, 2.51),
            None,
            (0.92, 0.66),
            (0.34, 0.13),
            (1.07, 1.18),
            (1.78, 3.03),
            (21.75, 2.99),
        ),
        "FreeArtGS, CoTracker3": (
            (1.98, 3.09),
            None,
            (1.12, 0.68),
            (0.79, 1.08),
            (0.98, 1.22),
            (0.94, 1.18),
            (21.85, 3.64),
        ),
        "FreeArtGS, DINOv2": (
            (1.46, 1.63),
            None,
            (0.96, 1.59),
            (0.56, 0.40),
            (0.99, 0.93),
            (0.46, 0.51),
            (22.39, 3.92),
        ),
    },
}
_V2A_JOINT: dict[Literal["revolute", "prismatic"], dict[str, tuple[Value | None, ...]]] = {
    "revolute": {
        "Articulate-Anything": ((46.98, 45.27), (81.00, 40.00), None),
        "RSRD": ((67.06, 29.22), (203.00, 748.00), (59.02, 34.38)),
        "Video2Articulation": ((18.34, 32.09), (13.00, 25.00), (14.32, 26.35)),
        "FreeArtGS": ((1.77, 2.87), (1.31, 1.81), (3.69, 6.60)),
    },
    "prismatic": {
        "Articulate-Anything": ((52.71, 44.69), None, None),
        "RSRD": ((69.91, 24.07), None, (70.00, 48.00)),
        "Video2Articulation": ((13.75, 18.91), None, (8.00, 22.00)),
        "FreeArtGS": ((0.77, 2.30), None, (1.00, 2.19)),
    },
}
_V2A_SURFACES: dict[str, tuple[Value | None, ...]] = {
    "Articulate-Anything": ((11.00, 22.00), (59.00, 73.00), (7.00, 18.00)),
    "RSRD": ((339.00, 2147.00), (82.00, 117.00), (14.00, 41.00)),
    "Video2Articulation": ((1.00, 1.00), (13.00, 26.00), (6.00, 19.00)),
    "FreeArtGS": ((1.87, 2.19), (1.00, 2.22), (2.39, 2.50)),
}
_CAMERAS: dict[str, tuple[Value | None, ...]] = {
    "Video2Articulation": ((4.621, None), (9.246, None)),
    "FreeArtGS": ((2.483, None), (1.526, None)),
}
_MASKS: dict[str, dict[str, tuple[Value | None, ...]]] = {  # printed in percent
    FREEART21: {"Video2Articulation": ((0.3461, None),), "FreeArtGS": ((0.9088, None),)},
    V2A_S: {"Video2Articulation": ((0.5965, None),), "FreeArtGS": ((0.8492, None),)},
}
_REAL: dict[str, tuple[Value | None, ...]] = {"FreeArtGS": ((2.73, None), (1.06, None), (2.48, None), (22.40, None))}

PUBLISHED: tuple[PublishedRow, ...] = (
    *(
        row
        for group, lines in _TYPED.items()
        for row in _rows("paper-1", FREEART21, group, _MAIN, "table 'Results and Ablation Studies'", lines)
    ),
    *(
        row
        for group, lines in _ROBUSTNESS.items()
        for row in _rows("paper-1", FREEART21, group, _MAIN, "supplement, table 'Robustness Analysis'", lines)
    ),
    *_rows("paper-1", FREEART21, "all", ("miou",), "supplement, table 'Part Segmentation'", _MASKS[FREEART21]),
    *_rows(
        "paper-1",
        REAL,
        "all",
        ("axis", "position", "cd_w", "psnr"),
        "table 'Real-world Objects', averages; errors below 0.1 deg and 0.1 cm were raised to that",
        _REAL,
    ),
    *(
        row
        for group, lines in _V2A_JOINT.items()
        for row in _rows("itaco-1", V2A_S, group, _JOINT, "table 'Results on Video2Articulation-S'", lines)
    ),
    *_rows("itaco-1", V2A_S, "all", _SURFACES, "table 'Results on Video2Articulation-S'", _V2A_SURFACES),
    *_rows(
        "itaco-1",
        V2A_S,
        "all",
        ("camera_rotation", "camera_position"),
        "supplement, table 'Camera Pose Estimation'",
        _CAMERAS,
    ),
    *_rows("itaco-1", V2A_S, "all", ("miou",), "supplement, table 'Part Segmentation'", _MASKS[V2A_S]),
)
"""The tables of the FreeArtGS paper. Its rows of other methods on Video2Articulation-S are what their own papers print,
in metres, times 100."""
