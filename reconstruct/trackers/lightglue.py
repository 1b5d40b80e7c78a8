"""The tracker `lightglue`: optical flow that starts from LightGlue's matches (extra `priors`)."""

from __future__ import annotations

from reconstruct.trackers.matched import MatchedFlow


class LightGlue(MatchedFlow):
    """Chained flow between neighbouring frames."""

    name = matcher = "lightglue"
