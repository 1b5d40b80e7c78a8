"""A simulation-ready asset: a URDF with meshes, effects beyond URDF, and its pose in the canonical frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from freeart21.effects.base import Effect
from freeart21.reconstruction import Trust
from freeart21.se3 import Array, check_poses


@dataclass(frozen=True)
class Asset:
    """One articulated object on disk; one joint of it, between the reference link and the moving link, is scored."""

    urdf: Path
    """The URDF file."""
    joint: str
    """Name of the scored joint in the URDF."""
    reference_link: str
    """Link of the reference part, on one side of the joint."""
    moving_link: str
    """Link of the moving part, on the other side."""
    T_canonical_reference: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) the reference link's frame in the canonical frame."""
    state_zero: float = 0.0
    """Position of the URDF joint, rad or m, at canonical state zero."""
    effects: dict[str, tuple[Effect, ...]] = field(default_factory=dict)
    """Joint name to the effects on it, from effects.json or, without one, from the URDF's `<dynamics>`."""
    held: dict[str, float] = field(default_factory=dict)
    """Other joints and the positions, rad or m, at which they are held fixed."""
    source: dict[str, Any] = field(default_factory=dict)
    """Provenance, as in asset.json."""
    scale: float = 1.0
    """Lengths of the asset, its canonical frame and a prismatic joint's states over those of its video; 1 unless
    exported at another size."""
    trust: Trust | None = None
    """Trust in the reconstruction it was made from; None when not stated."""
    root: Path | None = None
    """Folder that bounds the files named by the URDF; None: that of `urdf_files.find_root`."""

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "T_canonical_reference", check_poses("asset T_canonical_reference", self.T_canonical_reference)
        )

    def facts(self, *keys: str) -> dict[str, Any]:
        """The object of `source` that the keys lead to, such as "parts", "moving"; empty where there is none."""
        found: Any = self.source
        for key in keys:
            found = found.get(key) if isinstance(found, dict) else None
        return found if isinstance(found, dict) else {}
