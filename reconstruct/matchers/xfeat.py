"""The matcher `xfeat`: XFeat's keypoints, each the other's most similar."""

from __future__ import annotations

import numpy as np

from reconstruct.matchers.base import KeypointMatcher, Matches
from reconstruct.priors import xfeat

LEAST_COSINE = 0.82
"""Least similarity of a match; the authors'."""


class Xfeat(KeypointMatcher):
    """Mutual nearest neighbours among XFeat's keypoints on the object."""

    name = "xfeat"
    load = staticmethod(xfeat.load_network)
    detect = staticmethod(xfeat.detect)

    def match(self, first: int, second: int) -> Matches:
        """See `Matcher`; the confidence is the cosine of the descriptors."""
        (here, a), (there, b) = self.describe(first), self.describe(second)
        if not len(a) or not len(b):
            return Matches.none()
        cosine = a @ b.T
        forward, back = cosine.argmax(1), cosine.argmax(0)
        i = np.flatnonzero((back[forward] == np.arange(len(a))) & (cosine.max(1) > LEAST_COSINE))
        j = forward[i]
        return Matches(here[i], there[j], np.clip(cosine[i, j].astype(float), 0, 1))
