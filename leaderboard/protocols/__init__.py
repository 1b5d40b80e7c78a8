"""Named protocols, one file each: what each number means, in which unit, what a failure costs, and how it is measured.

A protocol's text and numbers never change: a changed definition is a new protocol with a new name.
"""

from __future__ import annotations

from freeart21.errors import FreeArtError
from leaderboard.protocol import Group, Metric, Protocol
from leaderboard.protocols.strict1 import STRICT_1
from leaderboard.protocols.strict2 import STRICT_2

__all__ = ["DEFAULT", "PROTOCOLS", "STRICT_1", "STRICT_2", "Group", "Metric", "Protocol", "protocol_named"]

PROTOCOLS: dict[str, Protocol] = {p.name: p for p in (STRICT_1, STRICT_2)}
"""Every protocol by its name."""
DEFAULT = STRICT_2.name
"""The protocol by which is scored when none is named."""


def protocol_named(name: str) -> Protocol:
    """The protocol `name`; FreeArtError lists the known ones."""
    if name not in PROTOCOLS:
        raise FreeArtError(f"unknown protocol '{name}'; protocols: {', '.join(sorted(PROTOCOLS))}")
    return PROTOCOLS[name]
