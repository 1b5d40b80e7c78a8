"""The stages of the solver in their order: the table that pipeline, cache and command line share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from freeart21.errors import FreeArtError


@dataclass(frozen=True)
class Stage:
    """One stage; `pipeline` has a function of the same name."""

    name: str
    description: str
    """For the help."""
    first_used_settings: tuple[str, ...] = ()
    """Groups of settings that no earlier stage depends on."""
    cached: bool = True
    """Whether its outcome is cached, so that a run may stop after it and continue from there."""


STAGES = (
    Stage("tracks", "crop, points and normals; optical flow", cached=False),  # fast to repeat, gigabytes to store
    Stage("segmentation", "two motions, propagated from a seed both ways in time"),
    Stage("joint", "gaps fixed, the joint's type, all adjusted under it", ("gaps",)),
    Stage("gaussians", "one model of both parts, fitted to every frame", ("gaussians", "surfaces")),
    Stage("poses", "both parts' poses without the joint"),
    Stage("surfaces", "depth fused to a mesh per part"),
    Stage("renders", "the held-out views", ("renders",), cached=False),  # written with the result
)

CACHED_STAGES = tuple(stage.name for stage in STAGES if stage.cached)

if TYPE_CHECKING:
    CachedStageName = str
else:
    CachedStageName = Literal[CACHED_STAGES]  # the choices of the command line


def require_cached(name: str) -> None:
    """Raises FreeArtError when no cached stage has this name."""
    if name not in CACHED_STAGES:
        raise FreeArtError(f"there is no stage '{name}' to stop after; expected one of {', '.join(CACHED_STAGES)}")


def settings_used_by(stage: str, groups: dict[str, Any]) -> dict[str, Any]:
    """The groups of settings that a cached stage and all before it depend on.

    A group that the table does not name counts from the first stage on.
    """
    later = STAGES[[row.name for row in STAGES].index(stage) + 1 :]
    unused = {group for row in later for group in row.first_used_settings}
    return {name: group for name, group in groups.items() if name not in unused}
