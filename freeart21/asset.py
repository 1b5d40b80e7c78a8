"""A simulation-ready asset: a URDF with meshes, the effects URDF cannot say, and how it sits in its canonical frame."""

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
    """One articulated object on disk, two of whose links matter: the reference link and the moving link."""

    urdf: Path
    """The URDF file."""
    joint: str
    """Name of the scored joint in the URDF."""
    reference_link: str
    """Link that carries the reference part: one side of the joint."""
    moving_link: str
    """Link that carries the moving part: the other side of the joint."""
    T_canonical_reference: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) canonical frame from the reference link's frame."""
    state_zero: float = 0.0
    """The URDF joint's position, rad or m, at the canonical state zero."""
    effects: dict[str, tuple[Effect, ...]] = field(default_factory=dict)
    """Joint name to the effects that act on it: from effects.json when there is one, else from URDF `<dynamics>`."""
    held: dict[str, float] = field(default_factory=dict)
    """Other joints and the positions, rad or m, at which they are held: they are frozen into the part they hang on."""
    source: dict[str, Any] = field(default_factory=dict)
    """Where the asset came from."""
    scale: float = 1.0
    """Lengths of the asset, of its canonical frame and of a prismatic joint's states over those of the video that it
    came from: 1 unless it was exported at another size."""
    trust: Trust | None = None
    """Whether the reconstruction that it was made of trusts itself; None when that is not stated."""
    root: Path | None = None
    """Folder within which the files lie that the URDF names; None takes what `urdf_files.find_root` finds."""

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "T_canonical_reference", check_poses("asset T_canonical_reference", self.T_canonical_reference)
        )
