"""Named protocols, one file each: what each number means, in which unit, what a failure costs, and how it is measured.

The text and values of a protocol never change: a changed definition is a new protocol with a new name.
"""

from __future__ import annotations

from freeart21.errors import FreeArtError
from freeart21.registry import find_instances
from leaderboard.protocol import Group, Metric, Protocol

__all__ = [
    "DEFAULT",
    "PROTOCOLS",
    "Group",
    "Metric",
    "Protocol",
    "protocol_named",
]

PROTOCOLS: dict[str, Protocol] = find_instances(__name__, Protocol)
"""Every protocol by its name: the modules of this folder, and entry points of others (`freeart21.registry`)."""
DEFAULT = "strict-3"
"""The default protocol: the newest that ranks."""


def protocol_named(name: str) -> Protocol:
    """The protocol `name`; FreeArtError lists the known ones."""
    if name not in PROTOCOLS:
        raise FreeArtError(f"unknown protocol '{name}'; protocols: {', '.join(sorted(PROTOCOLS))}")
    return PROTOCOLS[name]
