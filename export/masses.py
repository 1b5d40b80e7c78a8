"""Masses of the parts: given, or from materials, with bounds by what is not known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from export.inertia import compute_inertial, fill_range
from export.materials import DEFAULT, DENSITIES, TABLE
from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh

_T = TypeVar("_T")


@dataclass(frozen=True)
class PartMass:
    """The mass of one part."""

    density: float
    """kg/m^3 of its solid, or of its wall."""
    by: str
    """'mass', 'density' or 'material'."""
    material: str
    """Also the source of friction and restitution."""
    guessed: bool
    """Whether the mass is of a guessed material."""
    bounds_kg: tuple[float, float]

    def to_json(self) -> dict[str, Any]:
        """`mass` and `surface` of the part's entry in asset.json."""
        surface = TABLE[self.material]
        return {
            "mass": {
                "by": self.by,
                "density": self.density,
                "material": self.material,
                "guessed": self.guessed,
                "bounds_kg": self.bounds_kg,
            },
            "surface": {"friction": surface.friction, "restitution": surface.restitution},
        }


def weigh_parts(
    solids: Mapping[str, Mesh],
    links: Mapping[str, str],
    *,
    mass: float | Mapping[str, float] | None = None,
    density: float | None = None,
    material: str | Mapping[str, str] | None = None,
    wall: float | None = None,
) -> dict[str, PartMass]:
    """The mass of each part, given its closed mesh, m, the name of its link, and `export.exporter.ExportSettings`.

    A mass of the whole is divided by volume and density. Bounds: a given mass of a part is exact. Otherwise a part is
    at least a shell (`inertia.fill_range`) and at most solid, of any material when none was given. Of a given whole,
    one part is as light and the others as heavy as they can be.

    Raises FreeArtError when a setting names no part.
    """
    materials = resolve_parts(material, links, "material")
    given: dict[str, float] = resolve_parts(mass, links, "mass") if isinstance(mass, Mapping) else {}
    found = {}
    for name, solid in solids.items():
        kind = materials.get(name, DEFAULT)
        own = DENSITIES[kind] if density is None else density
        guessed = density is None and name not in materials
        least, most = fill_range(solid, wall)
        low, high = (min(DENSITIES.values()), max(DENSITIES.values())) if guessed else (own, own)
        by, bounds = "material" if density is None else "density", (low * least, high * most)
        if name in given:
            own = given[name] / compute_inertial(solid, 1.0, wall).mass
            by, guessed, bounds = "mass", False, (given[name], given[name])
        found[name] = PartMass(own, by, kind, guessed, bounds)
    return found if mass is None or isinstance(mass, Mapping) else _divide(mass, solids, wall, found)


def _divide(
    mass: float, solids: Mapping[str, Mesh], wall: float | None, found: Mapping[str, PartMass]
) -> dict[str, PartMass]:
    """The parts with `mass`, kg, for the whole."""
    factor = mass / sum(compute_inertial(solid, found[name].density, wall).mass for name, solid in solids.items())
    lows, highs = (sum(part.bounds_kg[k] for part in found.values()) for k in (0, 1))
    divided = {}
    for name, part in found.items():
        low, high = part.bounds_kg
        bounds = (mass * low / (low + highs - high), mass * high / (high + lows - low))
        divided[name] = PartMass(factor * part.density, "mass", part.material, False, bounds)
    return divided


def resolve_parts(given: _T | Mapping[str, _T] | None, links: Mapping[str, str], what: str) -> dict[str, _T]:
    """A value a part: `given` is one for all, or by the name of a part or of its link (`links`, by part), or None.

    Raises FreeArtError for a name that is none.
    """
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        return dict.fromkeys(links, given)
    parts = {link: part for part, link in links.items()} | {part: part for part in links}
    for name in given:
        if name not in parts:
            raise FreeArtError(f"{what} of '{name}': there is no such part; parts: {', '.join(dict.fromkeys(parts))}")
    return {parts[name]: value for name, value in given.items()}
