"""The matcher `lightglue`: ALIKED's keypoints, matched by LightGlue, which sees all of both frames at once."""

from __future__ import annotations

from reconstruct.matchers.base import KeypointMatcher, Matches
from reconstruct.priors import lightglue


class LightGlue(KeypointMatcher):
    """For frames far apart: some 1 s of processor time a pair."""

    name = "lightglue"
    load = staticmethod(lightglue.load_networks)
    detect = staticmethod(lightglue.detect)

    def match(self, first: int, second: int) -> Matches:
        """See `Matcher`; the confidence is LightGlue's."""
        (here, a), (there, b) = self.describe(first), self.describe(second)
        if not len(a) or not len(b):
            return Matches.none()
        h, w = self.scene.mask.shape[1:]
        pairs, confidence = lightglue.match(here, a, there, b, (w, h))
        return Matches(here[pairs[:, 0]], there[pairs[:, 1]], confidence)
