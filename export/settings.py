"""Settings of `export` and `joint-asset`: also their command lines, so nothing heavy is imported here."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any, Literal, get_args

import tyro

from export.materials import MATERIALS
from freeart21.errors import FreeArtError

Zero = Literal["first", "closed", "lower", "upper"]
Contact = Literal["fine", "fast"]
Dynamics = Literal["guessed", "none"]
Names = Literal["part", "role"]
Base = Literal["free", "fixed"]
JointKind = Literal["pendulum", "door", "drawer"]
Direction = Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z")]
Hidden: Any = tyro.conf.Suppress
TOLERANCE = 5e-4
"""m: overlap that an asset may have, and increase in overlap that counts as contact."""
_BOUNDS = {
    "density": (" kg/m^3", 1e-3, 1e5),
    "wall": (" m", 1e-5, 1.0),
    "mass": (" kg", 1e-6, 1e6),
    "scale": ("", 1e-4, 1e4),
}
"""Unit and bounds: of matter on earth, with room; from foil to masonry; what single precision can handle."""


def _read_by_part(option: str, read: Callable[[str], Any], words: list[str]) -> Any:
    """One value for all parts, or a dictionary of NAME=VALUE; None without words."""
    if not words:
        return None
    if len(words) == 1 and "=" not in words[0]:
        return read(words[0])
    pairs = [word.partition("=") for word in words]
    if wrong := [word for word, (name, _, value) in zip(words, pairs, strict=True) if not (name and value)]:
        raise FreeArtError(f"--{option} has '{wrong[0]}', expected one value, or NAME=VALUE for each part")
    return {name: read(value) for name, _, value in pairs}


def _read_kilograms(text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise FreeArtError(f"--mass has '{text}', expected kg") from error


def _words(metavar: str, read: Callable[[list[str]], Any], text: Callable[[Any], str] = str, **how: Any) -> Any:
    """How tyro reads a value of any number of words."""
    spec = tyro.constructors.PrimitiveConstructorSpec
    return spec("*", metavar, read, lambda value: True, lambda value: [text(value)], **how)


_USD = {"auto": None, "yes": True, "no": False}
Masses = Annotated[
    float | Mapping[str, float] | None, _words("KG | NAME=KG...", partial(_read_by_part, "mass", _read_kilograms))
]
Materials = Annotated[
    str | Mapping[str, str] | None, _words("MATERIAL | NAME=MATERIAL...", partial(_read_by_part, "material", str))
]
Usd = Annotated[
    bool | None,
    _words("{auto,yes,no}", lambda words: _USD[words[0]], {v: k for k, v in _USD.items()}.get, choices=(*_USD,)),
]


@dataclass(frozen=True)
class PlacementSettings:
    """Up direction, joint zero, and tolerance of overlap."""

    up: Direction = None
    """Direction that becomes z, in the result's canonical frame (ours: the camera's of the first frame, right, down,
    forward); from gravity or the likeliest resting pose when not given."""
    gravity: Direction = None
    """Direction of gravity in the camera's axes (right, down, forward) of the first frame, 0 9.81 0 for a level camera;
    only when the reference part stood still before the camera, and not together with `up`."""
    zero: Zero = "closed"
    """Joint position that becomes zero: that of the first frame, the end where both parts fill the least space
    (closed), or the lower or upper end."""
    tolerance_m: Hidden[float] = TOLERANCE
    """m that the parts may overlap, in the asset's own lengths when it is scaled."""
    carve: Hidden[bool] = True
    """Whether the volume swept by one part is subtracted from the other, where both are closed."""

    def check(self) -> None:
        """Raise FreeArtError when a setting is invalid."""
        for name in ("up", "gravity"):
            d = getattr(self, name)
            if d is not None and not (len(d) == 3 and all(map(math.isfinite, d)) and any(d)):
                raise FreeArtError(f"{name} is {d}, expected three finite numbers that are not all zero")
        if self.up is not None and self.gravity is not None:
            raise FreeArtError("up and gravity are both given: give one of them")
        if self.zero not in get_args(Zero):
            raise FreeArtError(f"zero is '{self.zero}', expected one of {', '.join(get_args(Zero))}")
        if not 0 < self.tolerance_m < math.inf:
            raise FreeArtError(f"tolerance_m is {self.tolerance_m:g} m, expected more than 0")


@dataclass(frozen=True)
class MeshSettings:
    """Sizes of part meshes."""

    max_faces: int = 20_000
    """Most faces of a part; more are decimated (`export.surface`)."""
    points: int = 25_000
    """Approximate number of surface points with which a part is closed; a cut through 60 000 took a minute."""


@dataclass(frozen=True)
class CollisionSettings:
    """Settings of the convex decomposition."""

    tolerance_m: float = 1.2e-3
    """m that a hull may extend beyond the part. For parts under 6 cm a fiftieth of their size; for large ones half the
    spacing of surface points, 1.5 mm for a cabinet of 65 cm."""
    max_hulls: int = 256
    """Most hulls per part; beyond, the tolerance is widened."""
    min_share: float = 0.0025
    """Least share of a part's surface that a shape alone must cover, so that roughness costs no shapes: of a drawer's
    360 shapes beside its boards 338 covered less."""
    primitives: bool = True
    """Whether boxes, cylinders and spheres replace hulls where they fit as well."""
    pairs: int = 40_000
    """Most pairs of hulls tested for merging; bounds the time."""


PRESETS: dict[str, CollisionSettings] = {
    "fine": CollisionSettings(),
    "fast": CollisionSettings(tolerance_m=3e-3, max_hulls=16, min_share=0.01, pairs=16_000),
}
"""Contact shapes within about a millimetre, and at most 16 a part for fast simulation."""


@dataclass(frozen=True)
class JointNumbers:
    """Known numbers of a joint and its moving part, for `joint-asset`."""

    mass: float
    """Mass of the moving part, kg."""
    kind: JointKind = "pendulum"
    """A pendulum turns about y and hangs down at 0, a door turns about z, a drawer slides along x; z is up."""
    length: float | None = None
    """Distance from the joint's axis to the centre of mass, m; 0 for a rotor (with --kind door)."""
    inertia: float | None = None
    """Inertia about the joint's axis, kg*m^2; that of a point mass at the length when not given."""
    period: float | None = None
    """Period of small free swings of the pendulum, s: gives the length or, with --length, the inertia."""
    lower: float | None = None
    """Lower limit of the joint, rad or m; no limits when not given."""
    upper: float | None = None
    """Upper limit of the joint, rad or m."""
    joint: str = "hinge"
    """Name of the joint."""


@dataclass(frozen=True)
class ExportSettings:
    """What `export` makes of a result."""

    density: float | None = None
    """Density of both parts, kg/m^3; that of the material when not given, as video shows no mass."""
    material: Materials = None
    """Material of both parts, or of each by its link's name, as base=steel drawer=wood, also for friction and
    restitution: plastic, wood, steel, aluminium, glass, rubber, cardboard; plastic (1050 kg/m^3) when not given."""
    wall: float | None = None
    """Wall thickness of hollow parts, m; solid parts when not given."""
    mass: Masses = None
    """Mass of the whole object instead, kg, split between the parts by volume and density, or of parts by their link's
    name, as base=2.2 drawer=.5."""
    dynamics: Dynamics = "guessed"
    """Damping and friction of the joint, which the video does not show: small guessed values, or none."""
    scale: float = 1.0
    """Factor for all lengths. Assets of another scale than 1 are not scored."""
    placement: Annotated[PlacementSettings, tyro.conf.arg(name="")] = field(default_factory=PlacementSettings)
    """Which way is up, where the joint is at zero and where it ends."""
    effort: Hidden[float] = 100.0
    """URDF effort limit, N m or N. A default: video does not show it."""
    velocity: Hidden[float] = 10.0
    """URDF velocity limit, rad/s or m/s. A default: video does not show it."""
    names: Names = "part"
    """Links are named by their role (base; lid, door, drawer, slider, handle, or part where it is unclear), or
    reference and moving (part)."""
    base: Base = "free"
    """Whether the reference part moves freely or is fixed in the world (in URDF to a link named world)."""
    usd: Usd = None
    """Write object.usdc too; auto: if usd-core is installed."""
    meshes: Hidden[MeshSettings] = field(default_factory=MeshSettings)
    """Visual meshes and textures."""
    contact: Contact = "fine"
    """Collision shapes: fine, within about a millimetre; or fast, at most 16 a part."""
    collision: Hidden[CollisionSettings | None] = None
    """Collision shapes in detail; None: as `contact` says."""

    def check(self) -> None:
        """Raise FreeArtError when a setting is invalid."""
        if self.base not in get_args(Base):
            raise FreeArtError(f"base is '{self.base}', expected {' or '.join(get_args(Base))}")
        if self.density is not None and self.mass is not None:
            raise FreeArtError(f"density {self.density:g} kg/m^3 and mass {self.mass:g} kg: give one of them")
        self.placement.check()
        kinds = {"dynamics": get_args(Dynamics), "contact": get_args(Contact), "names": get_args(Names)}
        for name, known in {"material": MATERIALS, **kinds}.items():
            for value in _each_value(getattr(self, name)):
                if value not in known:
                    raise FreeArtError(f"there is no {name} '{value}'; there are {', '.join(known)}")
        for name, (unit, low, high) in _BOUNDS.items():
            for value in _each_value(getattr(self, name)):
                if not low <= value <= high:
                    raise FreeArtError(f"{name} is {value:g}{unit}, expected {low:g} to {high:g}")


def _each_value(given: Any) -> tuple[Any, ...]:
    """The values of a setting that is one for all parts, one each, or None."""
    if isinstance(given, Mapping):
        return tuple(given.values())
    return () if given is None else (given,)
