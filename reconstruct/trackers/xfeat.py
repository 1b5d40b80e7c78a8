"""The tracker `xfeat`: optical flow that starts from XFeat's matches (extra `priors`)."""

from __future__ import annotations

from reconstruct.trackers.matched import MatchedFlow


class Xfeat(MatchedFlow):
    """Chained flow between neighbouring frames."""

    name = matcher = "xfeat"
