"""Points: what a row is worth in four tracks, by fixed scales, so that no other method changes it.

A metric gives 1 / (1 + error / half) points: 1 where nothing is wrong, 1/2 at its `half`. A track is the mean over its
metrics; a method has the mean over its sequences, 0 for each that it failed. Two methods are compared by the paired
bootstrap interval of the difference of their points, whoever else takes part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from freeart21.files.result import Method
from freeart21.se3 import Array
from leaderboard.bootstrap import bootstrap_intervals
from leaderboard.protocol import Metric, Protocol
from leaderboard.rows import Row, Scores

HALF = {
    "joint_type": 0.5,
    "axis": 1.0,
    "position": 0.5,
    "state": 1.0,
    "miou": 0.1,
    "pose_rotation": 1.0,
    "pose_translation": 0.5,
    "pose_moving_rotation": 1.0,
    "pose_moving_translation": 0.5,
    "chamfer_w": 0.5,
    "chamfer_m": 0.5,
    "chamfer_s": 0.5,
    "depth_median": 0.5,
    "depth_95": 5.0,
    "silhouette": 0.05,
    "area": 1.0,
    "psnr": 10 ** (-30 / 20),
    "ssim": 0.05,
    "view_iou": 0.05,
}
"""Metric to the error that gives half a point, in its unit: deg, % of the diagonal, 1 - fraction, 1, root mean
square of a picture in whites (30 dB). They are of the size that FreeArtGS reports as means (table 1: axis 1.0 to 1.9
deg, states 1.4 deg, mIoU .91, 24 dB inside the mask), so that today's methods lie in the middle of the scale."""
HALF_IN_UNITS = {
    "psnr": 30.0,
    **{id: 1 - HALF[id] for id in ("joint_type", "miou", "silhouette", "ssim", "view_iou")},
}
"""The same as values of the metric, where these are not errors."""
JOINT = ("joint_type", "axis", "position", "state")
PARTS = (*("miou", "pose_rotation", "pose_translation", "pose_moving_rotation", "pose_moving_translation"),)
GEOMETRY = ("chamfer_w", "chamfer_m", "chamfer_s", "depth_median", "depth_95", "silhouette", "area")
VIEWS = ("psnr", "ssim", "view_iou")
TRACKS: dict[str, tuple[tuple[str, ...], ...]] = {
    "whole": (JOINT, PARTS, GEOMETRY, VIEWS),
    "joint": (JOINT,),
    "geometry": (GEOMETRY,),
    "views": (VIEWS,),
}
"""Track to groups of metrics that weigh the same."""
FIRST = next(iter(TRACKS))
"""The track of the ranking."""
TRACK_TEXTS = {
    "whole": "joint, parts (masks and poses), geometry and views, a quarter each",
    "joint": "type, axis, position and states of the joint",
    "geometry": "surfaces: distances, depth from outside, silhouette, area",
    "views": "held-out views: pictures and silhouettes",
}


@dataclass(frozen=True)
class Standing:
    """A method in one track."""

    points: float
    """0 to 100: the mean over its sequences."""
    place: int | None
    """1 plus the number of methods that are better beyond doubt; those with one place are tied. None for
    methods outside the ranking."""


def is_outside_ranking(method: Method) -> bool:
    """Whether it has points and no place: it was given a part of the truth (`run`)."""
    return bool((method.settings or {}).get("privileged_inputs"))


def metric_points(metric: Metric, value: float) -> float:
    """Points, 0 to 1, of a metric's value in its unit."""
    unit = metric.unit("all")
    error = value
    if unit == "dB":
        error = 10 ** (-value / 20)
    elif unit == "fraction":
        error = 1 - value
    return float(1 / (1 + max(error, 0.0) / HALF[metric.id]))


def row_points(row: Row, track: str, rules: Protocol) -> float | None:
    """Points, 0 to 100, of a row in a track; 0 for a row that was not measured.

    Numbers that nobody has for this sequence (the place of a slider's axis, views without queries) are left out; None
    where no number is left.
    """
    metrics = {metric.id: metric for metric in rules.metrics if metric.unit(row.joint_type) is not None}
    groups = []
    for group in TRACKS[track]:
        values = [(metrics[id], row.values.get(id)) for id in group if id in metrics]
        points = [metric_points(metric, value) for metric, value in values if value is not None]
        if points:
            groups.append(float(np.mean(points)) if row.status == "ok" else 0.0)
    return 100 * float(np.mean(groups)) if groups else None


def track_points(scores: Scores, track: str, rules: Protocol, sequences: Sequence[str]) -> Array:
    """(n,) points of each sequence; NaN everywhere where the method has no place in the track."""
    rows = {row.sequence: row for row in scores.rows}
    needed = {piece for group in TRACKS[track] for m in rules.metrics if m.id in group for piece in m.needs}
    if needed & {*scores.method.lacks}:
        return np.full(len(sequences), np.nan)
    points = [row_points(rows[name], track, rules) if name in rows else None for name in sequences]
    return np.array([np.nan if p is None else p for p in points])


def standings(
    tables: Mapping[str, Scores], track: str, rules: Protocol, references: frozenset[str] = frozenset()
) -> dict[str, Standing]:
    """Method to its standing in a track; those that lack a number of it are left out.

    Args:
        tables: method to its table.
        track: of `TRACKS`.
        rules: the protocol of all tables.
        references: methods that have points and no place.
    """
    sequences = sorted({row.sequence for table in tables.values() for row in table.rows})
    points = {name: track_points(table, track, rules, sequences) for name, table in tables.items()}
    points = {name: own for name, own in points.items() if np.isfinite(own).any()}
    found = {}
    for name, own in points.items():
        others = [other for rival, other in points.items() if rival != name and rival not in references]
        better = sum(_is_better(other, own) for other in others)
        found[name] = Standing(float(np.nanmean(own)), None if name in references else 1 + better)
    return found


def _is_better(points: Array, other: Array) -> bool:
    """Whether the paired differences are above 0 beyond doubt; too few sequences tell nobody apart."""
    interval = bootstrap_intervals((points - other)[:, None])[0]
    return interval is not None and interval.low is not None and interval.low > 0
