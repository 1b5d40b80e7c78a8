"""LOSSES.md: properties of an asset that each format and engine keeps or loses.

Cells were verified in the version named by the column, in `tests/test_loaders.py`, `test_usd.py` and `test_losses.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from export.loaders import find_base, joint_numbers
from freeart21.asset import Asset
from freeart21.effects import EFFECTS
from freeart21.effects.base import Effect
from freeart21.files import atomic
from freeart21.files.urdf import read_urdf
from freeart21.reconstruction import describe_trust

FILE = "LOSSES.md"
KEPT, LOST, LOADER = "kept", "**lost**", "lost, the loader puts it back"
SUBJECTS = {
    "limits": "joint limits",
    "free": "a base that moves freely",
    "fixed": "a base that stands fixed",
    "effort": "effort limit",
    "velocity": "velocity limit",
    "parts": "the two parts do not collide with each other",
    "texture": "textures",
    "surface": "friction of the surfaces, by material",
    "restitution": "restitution of the surfaces, by material",
    "own": "nothing of the engine's own",
    "canonical": "where the video's frame and state zero are",
}
"""Properties of an asset besides the effects of its joint."""


@dataclass(frozen=True)
class Column:
    """A format, or an engine that reads one."""

    name: str
    """With the tested version."""
    reads: str
    """The asset's file."""
    outcomes: Mapping[str, str]
    """Property or effect name to what happens to it; without an entry a property is kept, an effect lost."""
    notes: tuple[str, ...] = field(default=())
    """Remarks."""


_FILES = {"canonical": "**lost**: it stands in asset.json"}


def _effects_by_parameter(**words: str) -> dict[str, str]:
    """Outcomes of the effects that a format or engine has as a parameter of a joint (`Effect.joint_word`)."""
    return {name: words[kind.joint_word] for name, kind in EFFECTS.items() if kind.joint_word in words}


_URDF_EFFECTS = {name: KEPT for name, kind in EFFECTS.items() if kind.urdf_dynamics is not Effect.urdf_dynamics}
_MJCF_EFFECTS = {name: KEPT for name, kind in EFFECTS.items() if kind.mjcf_joint is not Effect.mjcf_joint}
_USD_EFFECTS = _effects_by_parameter(
    damping="kept: drive",
    stiffness="kept: drive",
    friction="PhysX 5.6's and Newton's names, which UsdPhysics lacks",
    armature="PhysX's and Newton's names, which UsdPhysics lacks",
)
_SOFT_FRICTION = _effects_by_parameter(friction="kept, softly: a joint that it holds creeps")

FORMATS = (
    Column(
        "URDF",
        "object.urdf",
        _FILES | _URDF_EFFECTS | {"parts": "**lost**: engines decide", "surface": LOST, "restitution": LOST},
    ),
    Column("MJCF", "object.xml", _FILES | _MJCF_EFFECTS | {"velocity": LOST, "restitution": LOST}),
    Column(
        "USD (usd-core 26.11)",
        "object.usdc",
        _FILES | _USD_EFFECTS | {"velocity": "PhysX's and Newton's names, which UsdPhysics lacks"},
    ),
)
ENGINES = (
    Column(
        "SAPIEN 3.0.3",
        "object.urdf",
        {
            "free": "fixed, unless the loader puts it back",
            "surface": LOADER,
            "restitution": LOADER,
            "effort": "**lost**: give it to your drive as force_limit",
            "velocity": LOADER,
            "own": "0.05 1/s of damping a link, friction of 0.05 of the load, sleep; the loader takes them away",
            **_effects_by_parameter(damping=KEPT, friction=LOADER, armature=LOADER, stiffness=LOADER),
        },
        notes=("Its loader's friction is set for the scene's time step as it is when the asset is loaded.",),
    ),
    Column(
        "MuJoCo 4.0.0",
        "object.xml",
        {
            "limits": "soft: a stop that is met at 2.5 m/s gives by 13 mm",
            "velocity": LOST,
            "restitution": LOST,
            **_MJCF_EFFECTS,
            **_SOFT_FRICTION,
        },
    ),
    Column(
        "MuJoCo 4.0.0",
        "object.urdf",
        {
            "free": "**lost**: a URDF's root is always fixed",
            "velocity": LOST,
            "surface": LOST,
            "restitution": LOST,
            "texture": LOST,
            "parts": "**lost**: a part that stands in the world touches the other",
            **_URDF_EFFECTS,
            **_SOFT_FRICTION,
        },
    ),
    Column(
        "PyBullet 3.2.7",
        "object.urdf",
        {
            "effort": "a number that nothing keeps",
            "velocity": LOADER,
            "surface": LOADER,
            "restitution": LOADER,
            "own": "0.04 1/s of damping a link, a motor that holds every joint; the loader takes them away",
            **_effects_by_parameter(damping=KEPT, friction=LOADER),
        },
        notes=("Its loader makes the joint's motor its friction: it can do nothing else then.",),
    ),
    Column(
        "Drake 1.51.1",
        "object.urdf",
        {
            "effort": "**lost** without a transmission",
            "velocity": "a number that nothing keeps",
            "surface": LOST,
            "restitution": LOST,
            **_effects_by_parameter(damping=KEPT, friction=LOADER, armature=LOADER, stiffness=LOADER),
        },
        notes=("Its loader's friction acts in discrete plants only, and takes `connect` after `load`.",),
    ),
)


def list_subjects(asset: Asset, textured: bool) -> list[str]:
    """Properties of this asset: effects of its joint first, then keys of SUBJECTS."""
    joint = read_urdf(asset.urdf).joints[asset.joint]
    acting = dict.fromkeys(effect.name for effect in asset.effects.get(asset.joint, ()) if any(effect.values()))
    absent = {"free", "fixed"} - {find_base(asset)}
    absent |= set() if textured else {"texture"}
    absent |= set() if joint_numbers(asset)["surfaces"] else {"surface", "restitution"}
    absent |= {key for key in ("effort", "velocity") if getattr(joint, key) is None}
    return [*acting, *(key for key in SUBJECTS if key not in absent and key != "canonical"), "canonical"]


def outcome(column: Column, subject: str) -> str:
    """What happens to a property in a column."""
    return column.outcomes.get(subject, LOST if subject in EFFECTS else KEPT)


def format_losses(asset: Asset, textured: bool, files: frozenset[str]) -> str:
    """Text of LOSSES.md for an asset with these files; columns that read a missing file are left out."""
    rows = list_subjects(asset, textured)
    formats = [column for column in FORMATS if column.reads in files]
    engines = [column for column in ENGINES if column.reads in files]
    properties = [row for row in rows if row not in ("own", "canonical")]
    parts = [
        "# What formats and engines lose of this asset",
        f"Joint `{asset.joint}`; `effects.json`, or else the URDF's `<dynamics>`, lists all effects on it."
        " `loaders/load_ENGINE.py` holds a function `load` that puts back what can be put back.",
        f"Trust in the reconstruction that it was made of: **{describe_trust(asset.trust)}**",
        *_describe_contact(asset),
        *describe_limitations(asset),
        "## Files",
        _format_table(formats, [row for row in rows if row != "own"]),
        "## Engines",
        _format_table(engines, [*properties, "own"]),
    ]
    if "object.usdc" not in files:
        parts.append(
            "There is no USD: usd-core was not installed (`pip install 'freeart21[usd]'`), or none was requested."
        )
    parts += [f"{column.name}: {note}" for column in engines for note in column.notes]
    return "\n\n".join(parts) + "\n"


def _describe_contact(asset: Asset) -> list[str]:
    """A paragraph on the fidelity of contact stated in asset.json; none without it."""
    parts = asset.source.get("parts")
    descriptions = []
    for name, part in parts.items() if isinstance(parts, dict) else ():
        found = part.get("collision") if isinstance(part, dict) else None
        keys = ("worst_of_95_m", "worst_m", "outward_95_m", "outward_m")
        numbers = [x for key in keys if isinstance(x := found.get(key), int | float)] if isinstance(found, dict) else []
        if len(numbers) == len(keys):
            near, worst, out, furthest = (f"{1000 * number:.3g} mm" for number in numbers)
            descriptions.append(
                f"95 % of the visual surface of `{name}` lies within {near} of its collision shapes, all of it within "
                f"{worst}; 95 % of the collision shapes' surface lies at most {out} outside, all of it {furthest}"
            )
    return [f"Collision shapes approximate the visual meshes: {'; '.join(descriptions)}."] if descriptions else []


def describe_limitations(asset: Asset) -> list[str]:
    """A line for each part that is no solid, and for overlap that was not carved, as stated in asset.json."""
    parts, lines = asset.source.get("parts"), []
    for name, part in parts.items() if isinstance(parts, dict) else ():
        layers = part.get("layers") if isinstance(part, dict) and part.get("solid") is False else None
        if isinstance(layers, int | float):
            lines.append(
                f"`{name}` is no solid: its triangles have {layers:.3g} times the area of the solid around them. "
                "Its collision shape is one convex hull."
            )
    found = asset.source.get("penetration")
    why, deepest = (
        (found.get(key) for key in ("not_carved_because", "deepest_m")) if isinstance(found, dict) else (None,) * 2
    )
    if isinstance(why, str) and isinstance(deepest, int | float):
        lines.append(f"The two parts' collision shapes overlap by up to {1000 * deepest:.3g} mm: not carved, {why}.")
    return lines


def write_losses(folder: Path, asset: Asset) -> None:
    """Write LOSSES.md into a folder that already holds the asset's other files."""
    files = frozenset(path.name for path in folder.iterdir() if path.is_file())
    textured = any(path.name != "preview.png" for path in folder.rglob("*.png"))
    atomic.write_bytes(folder / FILE, format_losses(asset, textured, files).encode())


def _format_table(columns: list[Column], rows: list[str]) -> str:
    head = ["", *(f"{column.name}, `{column.reads}`" for column in columns)]
    lines = [head, ["---"] * len(head)]
    lines += [[_subject_name(row), *(outcome(column, row) for column in columns)] for row in rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _subject_name(subject: str) -> str:
    return SUBJECTS.get(subject, subject.replace("_", " "))
