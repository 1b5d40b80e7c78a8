"""strict-2: strict-1 with the asset's surfaces, the moving part's poses, and renders for either reference part.

Surfaces are those of the asset, posed by the simulator; those of the part files are extra metrics. docs/protocols.md
lists all differences to strict-1.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from freeart21 import se3
from freeart21.truth import Truth
from leaderboard import metrics
from leaderboard.matching import Matched, match
from leaderboard.protocol import Case, Measured, Metric, Protocol, to_floats
from leaderboard.protocols.strict1 import (
    PERCENT,
    ROTATION,
    STANDARD,
    STRICT_1,
    Strict1,
    answer_values,
    penalties,
    picture_values,
    surface_values,
)


def measure(case: Case, constants: Strict1 = STANDARD) -> Measured:
    """The metrics of strict-2; the part files replace an asset that there is not."""
    truth, matched = case.truth, match(case.truth, case.answer, case.lacks)
    parts = surface_values(truth, matched, matched.shape, constants)
    if case.asset is None:
        surfaces = parts
    else:
        named = case.asset.swapped() if matched.swapped else case.asset
        surfaces = surface_values(truth, matched, named.moved(matched.T_truth_pred), constants)
    other_views = matched.swapped and case.renders_other is not None
    values = {
        **answer_values(truth, matched, constants),
        **moving_pose_values(truth, matched),
        **surfaces,
        **{f"{id}_parts": value for id, value in parts.items()},
        **picture_values(truth, case.renders_other if other_views and case.renders_other is not None else case.renders),
    }
    return Measured(to_floats(values), matched.swapped, other_views)


def moving_pose_values(truth: Truth, matched: Matched) -> dict[str, float | None]:
    """The moving part's pose errors after a separate alignment, as methods choose its frame and state zero."""
    centre, Ts = matched.outer[1].centre, matched.answer.Ts_camera_moving
    T_truth_pred = metrics.align(truth.Ts_camera_moving, Ts, centre)
    angle, shift = metrics.pose_error(truth.Ts_camera_moving, Ts @ se3.inverse(T_truth_pred), centre)
    return {
        "pose_moving_rotation": float(np.rad2deg(angle)),
        "pose_moving_translation": 100 * shift / matched.diagonal,
    }


_OWN_ALIGNMENT = (
    "over all frames after an alignment of its own, the robust mean of the moving part's poses: its canonical frame "
    "and state zero are the method's affair, so this is how well the part is followed, whatever the joint"
)


def _of_parts(metric: Metric) -> Metric:
    """The same metric measured from the part files."""
    return replace(
        metric,
        id=f"{metric.id}_parts",
        definition=f"{metric.id} measured from parts/*.ply instead of the asset's visual meshes",
        supplements=metric.id,
        label=f"{metric.label}, from the part files",
        column="",
    )


def _strict_2_metrics() -> tuple[Metric, ...]:
    """Those of strict-1, with the moving part's poses and the part files' surfaces inserted."""
    metrics: list[Metric] = []
    for metric in STRICT_1.metrics:
        metrics.append(metric)
        if metric.id == "pose_translation":
            metrics += [
                Metric(
                    "pose_moving_rotation",
                    *ROTATION,
                    f"mean geodesic error of the moving part {_OWN_ALIGNMENT}",
                    label="rotation of the moving part",
                    column="moving\npart",
                    needs=("poses",),
                ),
                Metric(
                    "pose_moving_translation",
                    *PERCENT,
                    f"mean distance of the moving part's centre {_OWN_ALIGNMENT}",
                    label="place of the moving part",
                    needs=("poses",),
                ),
            ]
        if metric.id == "fscore":
            metrics += [_of_parts(m) for m in STRICT_1.metrics if m.id.startswith("chamfer") or m.id == "fscore"]
    return tuple(metrics)


STRICT_2 = Protocol(
    "strict-2",
    STRICT_1.preamble.replace(
        "The joint is measured from the asset, reloaded and driven in SAPIEN, states beyond its limits driven to the "
        "limit; without an asset, read from the files and marked so.",
        "The joint is measured from the asset, reloaded and driven in SAPIEN, states beyond its limits driven to the "
        "limit. Surfaces are the asset's own visual meshes, placed by the simulator's link poses at the answer's "
        "states; those of the part files stand beside. Without an asset both are read from the files and marked so. An "
        "asset with a broken mesh or mass is a failure. Held-out views may be given for both choices of the reference "
        "part; those of the matched choice count. A price is a cap: no number costs more than a failure.",
    ),
    _strict_2_metrics(),
    measure,
    asset="whole",
    capped=True,
    ranking=True,
    sequence_penalties=penalties,
)
