"""The certificate of an asset: how good it is, measured on the files that it consists of; certificate.json."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path

from freeart21.files import atomic, checked
from freeart21.files.json_record import read_record
from freeart21.reconstruction import NOT_STATED

FILE = "certificate.json"
SCHEMA = "freeart21/certificate/1"


@dataclass(frozen=True)
class LinkCertificate:
    """One link."""

    part: str
    """'reference' or 'moving', as in the reconstruction."""
    seen_share: float
    """Share of the visual mesh's area that the video showed."""
    supposed: dict[str, float]
    """How the rest was supplied, to its share of the area."""
    contact: dict[str, float]
    """m, distances between visual and collision surfaces (`export.fidelity.Fidelity`); empty without both."""
    mass: str
    """Source of its mass: 'given mass', 'given density', 'given material' or 'guessed material'."""
    material: str
    """Of its mass, unless that was given, and of its friction and restitution."""
    mass_kg: float
    mass_low_kg: float
    mass_high_kg: float
    """Bounds of the mass by what is not known of the material and the inside; equal for a given mass."""


@dataclass(frozen=True)
class EngineResult:
    """What an engine made of the asset."""

    version: str
    verdict: str
    """'reloaded' (poses agree), or 'pass', 'fail', 'unknown' of `check-asset`."""
    failed: tuple[str, ...] = ()
    """Rules that fail."""


@dataclass(frozen=True)
class Certificate:
    """Of the whole asset."""

    links: dict[str, LinkCertificate]
    visual_overlap_m: float
    """m, the deepest point of one visual mesh in the other over the joint's range."""
    contact_overlap_m: float
    """m, the same of the collision shapes."""
    upright: str
    """Source of the upright pose (`export.placement`)."""
    trust: str = NOT_STATED
    """'sound', 'doubtful' or 'not stated': of the reconstruction."""
    reasons: tuple[str, ...] = ()
    """Why it is doubtful."""
    engines: dict[str, EngineResult] = field(default_factory=dict)
    """Engine to its result; 'file' are the rules on files. Only what was tried."""


def write_certificate(folder: Path, certificate: Certificate) -> None:
    """Write certificate.json into an asset's folder."""
    atomic.write_json(folder / FILE, {"schema": SCHEMA, **asdict(certificate)})


def read_certificate(folder: Path) -> Certificate | None:
    """The certificate in an asset's folder, None without one; raises FreeArtError when it is invalid."""
    path = folder / FILE
    if not checked.is_there(path):
        return None
    data = {key: value for key, value in checked.read_json(path, SCHEMA).items() if key != "schema"}
    return read_record(Certificate, data, str(path))
