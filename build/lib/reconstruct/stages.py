"""The stages of the solver in their order: the one table that pipeline, cache and command line read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from freeart21.errors import FreeArtError


@dataclass(frozen=True)
class Stage:
    """A row: `pipeline` holds a function of the stage's name."""

    name: str
    does: str
    """For the help."""
    first_uses: tuple[str, ...] = ()
    """Groups of settings that no stage before it depends on."""
    kept: bool = True
    """Whether what it finds is kept, so that a run may stop after it and go on from there."""


STAGES = (
    Stage("tracks", "crop, points and normals; optical flow", kept=False),  # found again in seconds, gigabytes to keep
    Stage("segmentation", "where two motions beat one, grown both ways in time"),  # or the paper's
    Stage("joint", "exchanges and gaps mended, the joint's type, all adjusted under it", ("exchanges", "gaps")),
    Stage("gaussians", "one model of both parts, fitted to every frame", ("gaussians", "surfaces")),
    Stage("poses", "both parts' poses without the joint"),
    Stage("surfaces", "depth fused to a mesh a part"),
    Stage("renders", "the held-out views", ("renders",), kept=False),  # written with the result
)

KEPT = tuple(stage.name for stage in STAGES if stage.kept)

if TYPE_CHECKING:
    KeptStage = str
else:
    KeptStage = Literal[KEPT]  # what the command line offers


def require_kept(name: str) -> None:
    """Raises FreeArtError when no stage of this name is kept."""
    if name not in KEPT:
        raise FreeArtError(f"there is no stage '{name}' to stop after; expected one of {', '.join(KEPT)}")


def used_by(stage: str, groups: dict[str, Any]) -> dict[str, Any]:
    """Those of the settings, by group, that a kept stage and all before it depend on.

    A group that the table does not name counts from the first stage on.
    """
    later = STAGES[[row.name for row in STAGES].index(stage) + 1 :]
    unused = {group for row in later for group in row.first_uses}
    return {name: group for name, group in groups.items() if name not in unused}
