"""A method's result for one sequence, aligned with the truth as the protocol does it, for display.

When the truth is hidden, a result is shown in the camera frame of the first image, as its own poses say: nothing of the
truth is in it, not even an alignment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from freeart21 import se3
from freeart21.articulation import PARTS, Articulation
from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh
from freeart21.reconstruction import Failure, Piece
from freeart21.truth import Truth
from freeart21.view.source import Source, truth_source
from leaderboard import metrics
from leaderboard.submission import read_submission
from leaderboard.surface import Surface

EMPTY = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))


def read_answer(
    folder: Path,
    truth: Truth | int,
    frames: Sequence[int],
    swapped: bool,
    lacks: tuple[Piece, ...],
    size: tuple[int, int],
) -> Source:
    """The result in `folder`, in the truth's canonical frame, or in the first image's camera frame.

    Args:
        folder: The result.
        truth: What it is aligned with; the number of frames when that is hidden.
        frames: Frames whose part masks are kept.
        swapped: Whether scoring exchanged its part names.
        lacks: What the method does not make.
        size: (height, width) of the masks.

    Raises FreeArtError when it cannot be shown.
    """
    given, _ = read_submission(folder, truth if isinstance(truth, int) else len(truth), *size)
    if isinstance(given, Failure):
        raise FreeArtError(f"{folder.name} is a failure: {given.reason}")
    anchor = given.anchor
    if "poses" in lacks:  # as `matching.match`: the anchor frame's only, the moving part posed by its joint
        Ts = given.Ts_camera_reference[anchor]
        moving = Ts @ given.articulation.joint.transform(given.states)
        given = replace(given, Ts_camera_reference=np.repeat(Ts[None], len(given), 0), Ts_camera_moving=moving)
    given = given.exchanged() if swapped else given
    Ts = given.Ts_camera_reference
    if isinstance(truth, int):
        T_common_pred = Ts[anchor if "poses" in lacks else 0]
    else:
        shown = [anchor] if "poses" in lacks else slice(None)
        outer = Surface(truth.articulation.reference, truth.outer[0])
        T_common_pred = metrics.align(truth.Ts_camera_reference[shown], Ts[shown], outer.centre)
    parts = [EMPTY if "meshes" in lacks else replace(given.articulation.part(name), colours=None) for name in PARTS]
    masks = {i: given.part_masks[i].copy() for i in frames}
    source = Source(
        folder.name,
        articulation=Articulation(given.articulation.joint, *parts).moved(T_common_pred),
        states=given.states,
        Ts_camera=Ts[:0] if "poses" in lacks else Ts @ se3.inverse(T_common_pred),
        masks=None if "masks" in lacks else masks.__getitem__,
        zero=anchor if "states" in lacks else None,
    )
    return source if isinstance(truth, int) else source.follow(truth_source(truth))
