"""Named protocols, one file each: what each number means, in which unit, what a failure costs, and how it is measured.

A protocol's text and numbers never change: a changed definition is a new protocol with a new name.
"""

from __future__ import annotations

from freeart21.errors import FreeArtError
from leaderboard.protocol import Group, Metric, Protocol
from leaderboard.protocols.arena1 import ARENA_1
from leaderboard.protocols.itaco1 import ITACO_1
from leaderboard.protocols.paper1 import PAPER_1
from leaderboard.protocols.strict1 import STRICT_1
from leaderboard.protocols.strict2 import STRICT_2

__all__ = [
    "ARENA_1",
    "DEFAULT",
    "ITACO_1",
    "PAPER_1",
    "PROTOCOLS",
    "STRICT_1",
    "STRICT_2",
    "Group",
    "Metric",
    "Protocol",
    "protocol_named",
]

PROTOCOLS: dict[str, Protocol] = {p.name: p for p in (STRICT_1, STRICT_2, PAPER_1, ITACO_1, ARENA_1)}
"""Every protocol by its name."""
DEFAULT = STRICT_2.name
"""The protocol by which is scored when none is named."""


def protocol_named(name: str) -> Protocol:
    """The protocol `name`; FreeArtError lists the known ones."""
    if name not in PROTOCOLS:
        raise FreeArtError(f"unknown protocol '{name}'; protocols: {', '.join(sorted(PROTOCOLS))}")
    return PROTOCOLS[name]
