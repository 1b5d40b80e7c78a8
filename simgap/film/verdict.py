"""The answer: what the simulated camera lacks, how sure that is, what cannot be told, and what is left."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from freeart21.camera_faults import CameraFaults
from freeart21.files import atomic
from freeart21.files.camera_faults import faults_json
from simgap.film.missing import MissingPart

SCHEMA = "freeart21/verdict/film-1"
Answer = Literal["no_gap", "named", "ambiguous", "unexplained"]


@dataclass(frozen=True)
class Parameter:
    """One number of a named effect, SI units (pixels for places in the picture)."""

    value: float | tuple[float, ...]
    low: float | None
    high: float | None
    """90 % interval; None where none was made."""
    unit: str


@dataclass(frozen=True)
class Named:
    """One effect of the answer."""

    name: str
    parameters: dict[str, Parameter]
    """By field of `CameraFaults`."""
    p_value: float
    """That confirming frames gain as much by chance, corrected for the number of effects."""
    gain: float
    """Log predictive density that a confirming frame gains by it."""
    certain: bool
    """Whether every set that the frames cannot tell from the best has it: only these go into the camera."""


@dataclass(frozen=True)
class FilmGap:
    """How far the films are apart on the confirming frames, in one quantity."""

    quantity: str
    unit: str
    before: float
    after: float
    floor: float
    """What no named effect may be blamed for: the measurement's own steps, and noise once it is named."""


@dataclass(frozen=True)
class Where:
    """A place where the films part."""

    what: str
    over: str
    p_value: float
    text: str


@dataclass(frozen=True)
class FilmVerdict:
    """What `freeart21 gap` found between two films."""

    verdict: Answer
    sentence: str
    effects: tuple[Named, ...]
    rivals: tuple[tuple[str, ...], ...]
    """Sets that the frames cannot tell apart, the best first; empty when there is no doubt."""
    missing_part: MissingPart | None
    cannot_tell: tuple[tuple[str, str], ...]
    """Names, and why nothing is said of them."""
    left: tuple[str, ...]
    """What remains without a name, a line each."""
    where: tuple[Where, ...]
    gaps: tuple[FilmGap, ...]
    frames: dict[str, list[int]]
    """fit, choose and confirm to the frames' numbers."""
    camera: CameraFaults
    """What is certain, as the recorder takes it."""
    poses: str
    notes: tuple[str, ...] = ()

    @property
    def in_part(self) -> bool:
        """Whether what is named leaves something above the floor."""
        return bool(self.left) and self.verdict in ("named", "ambiguous")

    def to_json(self) -> dict[str, Any]:
        """As it stands in verdict.json."""
        part = self.missing_part
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "in_part": self.in_part,
            "sentence": self.sentence,
            "effects": [
                {
                    "name": e.name,
                    "parameters": {name: vars(p) for name, p in e.parameters.items()},
                    "p_value": e.p_value,
                    "gain": e.gain,
                    "certain": e.certain,
                }
                for e in self.effects
            ],
            "missing_part": None
            if part is None
            else {
                "part": part.part,
                "middle_m": part.middle,
                "size_m": part.size,
                "frames": part.frames,
                "share_told": part.told,
                "share_of_pixels": part.pixels,
            },
            "rivals": [list(names) for names in self.rivals],
            "cannot_tell": [{"names": names, "why": why} for names, why in self.cannot_tell],
            "left": list(self.left),
            "where": [vars(w) for w in self.where],
            "gap": [vars(g) for g in self.gaps],
            "frames": self.frames,
            "poses": self.poses,
            "camera": faults_json(self.camera),
            "notes": list(self.notes),
        }

    def write(self, path: Path) -> None:
        """Write verdict.json whole or not at all, with the names of the files that lie beside it ("files")."""
        files = sorted(file.relative_to(path.parent).as_posix() for file in path.parent.rglob("*") if file.is_file())
        atomic.write_json(path, {**self.to_json(), "files": files})
