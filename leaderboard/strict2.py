"""How strict-2 measures one answer against one truth: as strict-1, but for what is written in docs/protocols.md.

Surfaces are those of the asset as the simulator poses them, with those of the part files beside; the moving part's
poses count, too; held-out views may be given for both choices of the reference part.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from freeart21 import se3
from freeart21.reconstruction import Reconstruction
from freeart21.truth import Truth
from leaderboard import metrics
from leaderboard.strict1 import (
    Matched,
    Measured,
    Render,
    Shape,
    Strict1,
    answer_values,
    match,
    picture_values,
    plain,
    surface_values,
)


def measure(
    truth: Truth,
    answer: Reconstruction,
    renders: Sequence[Render],
    asset: Shape | None = None,
    renders_other: Sequence[Render] | None = None,
    constants: Strict1 | None = None,
) -> Measured:
    """Every number of strict-2 for an answer of as many frames as the truth, with masks of the truth's size.

    `asset` is the asset's own shape in the answer's canonical frame; None when there is no asset, and the part files
    stand for it. `renders` holds the answer's picture of each held-out query, or None where it has none;
    `renders_other` the same when the other part is the reference part, or None when the answer has none of these.
    """
    c = constants or Strict1()
    matched = match(truth, answer)
    parts = surface_values(truth, matched, matched.shape, c)
    if asset is None:
        surfaces = parts
    else:
        named = asset.swapped() if matched.swapped else asset
        surfaces = surface_values(truth, matched, named.moved(matched.T_truth_pred), c)
    other_views = matched.swapped and renders_other is not None
    values = {
        **answer_values(truth, matched, c),
        **moving_pose_values(truth, matched),
        **surfaces,
        **{f"{id}_parts": value for id, value in parts.items()},
        **picture_values(truth, renders_other if other_views and renders_other is not None else renders),
    }
    return Measured(plain(values), matched.swapped, other_views)


def moving_pose_values(truth: Truth, matched: Matched) -> dict[str, float | None]:
    """The moving part's pose errors after an alignment of its own: its frame and state zero are the method's affair."""
    centre, Ts = matched.outer[1].centre, matched.answer.Ts_camera_moving
    T_truth_pred = metrics.align(truth.Ts_camera_moving, Ts, centre)
    angle, shift = metrics.pose_error(truth.Ts_camera_moving, Ts @ se3.inverse(T_truth_pred), centre)
    return {
        "pose_moving_rotation": float(np.rad2deg(angle)),
        "pose_moving_translation": 100 * shift / matched.diagonal,
    }
