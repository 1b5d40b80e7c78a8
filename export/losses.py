"""LOSSES.md: what each format and each engine cannot say of one asset, out of one table of what each of them says.

What a cell holds was seen in the version that its column names, by `tests/test_loaders.py`, `test_usd.py` and
`test_losses.py`; the columns that say "as documented" were not run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from export.loaders import base_of
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
    "own": "nothing of the engine's own",
    "canonical": "where the video's frame and state zero are",
}
"""What there is to lose, beside the joint's effects."""


@dataclass(frozen=True)
class Column:
    """A format, or an engine that reads one."""

    name: str
    """With the version that was looked at."""
    reads: str
    """File of the asset."""
    says: Mapping[str, str]
    """Subject or name of an effect to what becomes of it; a subject that is not here is kept, an effect is lost."""
    seen: bool = True
    """Whether it was run, or is told by its documentation."""
    notes: tuple[str, ...] = field(default=())
    """What goes with the column."""


_FILES = {"canonical": "**lost**: it stands in asset.json"}


def _played(**words: str) -> dict[str, str]:
    """What becomes of the effects that a format or an engine has as a number of a joint, by `Effect.joint_word`."""
    return {name: words[kind.joint_word] for name, kind in EFFECTS.items() if kind.joint_word in words}


_URDF_EFFECTS = {name: KEPT for name, kind in EFFECTS.items() if kind.urdf_dynamics is not Effect.urdf_dynamics}
_MJCF_EFFECTS = {name: KEPT for name, kind in EFFECTS.items() if kind.mjcf_joint is not Effect.mjcf_joint}
_USD_EFFECTS = _played(
    damping="kept: drive",
    stiffness="kept: drive",
    friction="PhysX 5.6's and Newton's names, which UsdPhysics lacks",
    armature="PhysX's and Newton's names, which UsdPhysics lacks",
)
_SOFT_FRICTION = _played(friction="kept, softly: a joint that it holds creeps")

FORMATS = (
    Column("URDF", "object.urdf", _FILES | _URDF_EFFECTS | {"parts": "**lost**: engines decide"}),
    Column("MJCF", "object.xml", _FILES | _MJCF_EFFECTS | {"velocity": LOST}),
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
            "effort": "**lost**: give it to your drive as force_limit",
            "velocity": LOADER,
            "own": "0.05 1/s of damping a link, friction of 0.05 of the load, sleep; the loader takes them away",
            **_played(damping=KEPT, friction=LOADER, armature=LOADER, stiffness=LOADER),
        },
        notes=("Its loader's friction is set for the scene's time step as it is when the asset is loaded.",),
    ),
    Column(
        "MuJoCo 4.0.0",
        "object.xml",
        {
            "limits": "soft: a stop that is met at 2.5 m/s gives by 13 mm",
            "velocity": LOST,
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
            "own": "0.04 1/s of damping a link, a motor that holds every joint; the loader takes them away",
            **_played(damping=KEPT, friction=LOADER),
        },
        notes=("Its loader makes the joint's motor its friction: it can do nothing else then.",),
    ),
    Column(
        "Drake 1.51.1",
        "object.urdf",
        {
            "effort": "**lost** without a transmission",
            "velocity": "a number that nothing keeps",
            **_played(damping=KEPT, friction=LOADER, armature=LOADER, stiffness=LOADER),
        },
        notes=("Its loader's friction acts in discrete plants only, and takes `connect` after `load`.",),
    ),
    Column(
        "Isaac Sim 5, Isaac Lab",
        "object.usdc",
        _USD_EFFECTS | _played(friction="kept: staticFrictionEffort, dynamicFrictionEffort", armature=KEPT),
        seen=False,
        notes=(
            "Isaac's URDF importer drops friction; before Isaac Sim 5 friction is a coefficient of the joint's load, "
            "so that a torque cannot be said: there a drive of stiffness 0, maxForce of the friction and large "
            "damping does.",
        ),
    ),
    Column(
        "Newton",
        "object.usdc",
        _USD_EFFECTS | _played(friction="kept: newton:friction", armature=KEPT),
        seen=False,
        notes=("Its MuJoCo solver plays damping and friction of the URDF as they are (measured with 1.8.0).",),
    ),
)


def subjects_of(asset: Asset, textured: bool) -> list[str]:
    """What this asset has to lose: effects of its joint first, then keys of SUBJECTS."""
    joint = read_urdf(asset.urdf).joints[asset.joint]
    acting = dict.fromkeys(effect.name for effect in asset.effects.get(asset.joint, ()) if any(effect.values()))
    absent = {"free", "fixed"} - {base_of(asset)}
    absent |= set() if textured else {"texture"}
    absent |= {key for key in ("effort", "velocity") if getattr(joint, key) is None}
    return [*acting, *(key for key in SUBJECTS if key not in absent and key != "canonical"), "canonical"]


def told(column: Column, subject: str) -> str:
    """What becomes of a subject in a column."""
    return column.says.get(subject, LOST if subject in EFFECTS else KEPT)


def losses_text(asset: Asset, textured: bool, files: frozenset[str]) -> str:
    """LOSSES.md of an asset that has these files; what reads a file that is not there is left out."""
    rows = subjects_of(asset, textured)
    formats = [column for column in FORMATS if column.reads in files]
    engines = [column for column in ENGINES if column.reads in files]
    kept = [row for row in rows if row not in ("own", "canonical")]
    parts = [
        "# What formats and engines lose of this asset",
        f"Joint `{asset.joint}`; `effects.json`, or else the URDF's `<dynamics>`, is the whole list of what acts on it."
        " `loaders/load_ENGINE.py` holds a function `load` that puts back what can be put back.",
        f"Trust in the reconstruction that it was made of: **{describe_trust(asset.trust)}**",
        *_contact_losses(asset),
        *given_up(asset),
        "## Files",
        _table(formats, [row for row in rows if row != "own"]),
        "## Engines",
        _table([column for column in engines if column.seen], [*kept, "own"]),
    ]
    if untried := [column for column in engines if not column.seen]:
        parts += ["## As documented, not run", _table(untried, kept)]
    if "object.usdc" not in files:
        parts.append(
            "There is no USD: usd-core was not installed (`pip install 'freeart21[usd]'`), or none was asked for."
        )
    parts += [f"{column.name}: {note}" for column in engines for note in column.notes]
    return "\n\n".join(parts) + "\n"


def _contact_losses(asset: Asset) -> list[str]:
    """What asset.json states of how far contact is from what is seen, a paragraph; none where it states nothing."""
    parts = asset.source.get("parts")
    said = []
    for name, part in parts.items() if isinstance(parts, dict) else ():
        found = part.get("collision") if isinstance(part, dict) else None
        keys = ("worst_of_95_m", "worst_m", "outward_95_m", "outward_m")
        numbers = [x for key in keys if isinstance(x := found.get(key), int | float)] if isinstance(found, dict) else []
        if len(numbers) == len(keys):
            near, worst, out, furthest = (f"{1000 * number:.3g} mm" for number in numbers)
            said.append(
                f"of `{name}` 95 % of what is seen lies within {near} of contact, all of it within {worst}; 95 % of "
                f"contact stands out by {out} at most, all of it by {furthest}"
            )
    return [f"What is touched is not quite what is seen: {'; '.join(said)}."] if said else []


def given_up(asset: Asset) -> list[str]:
    """What asset.json states of parts that are no solids, and of parts that stayed in each other: a line each."""
    parts, lines = asset.source.get("parts"), []
    for name, part in parts.items() if isinstance(parts, dict) else ():
        layers = part.get("layers") if isinstance(part, dict) and part.get("solid") is False else None
        if isinstance(layers, int | float):
            lines.append(
                f"`{name}` is no solid: its triangles have {layers:.3g} times the area of what they enclose. "
                "What is touched of it is its one convex hull."
            )
    found = asset.source.get("penetration")
    why, deepest = (
        (found.get(key) for key in ("not_carved_because", "deepest_m")) if isinstance(found, dict) else (None,) * 2
    )
    if isinstance(why, str) and isinstance(deepest, int | float):
        deep = f"up to {1000 * deepest:.3g} mm in each other"
        lines.append(f"What is touched of the two parts is {deep}, and was not carved: {why}.")
    return lines


def write_losses(folder: Path, asset: Asset) -> None:
    """Write LOSSES.md beside the asset's other files, which are all there."""
    files = frozenset(path.name for path in folder.iterdir() if path.is_file())
    textured = any(path.name != "preview.png" for path in folder.rglob("*.png"))
    atomic.write_bytes(folder / FILE, losses_text(asset, textured, files).encode())


def _table(columns: list[Column], rows: list[str]) -> str:
    head = ["", *(f"{column.name}, `{column.reads}`" for column in columns)]
    lines = [head, ["---"] * len(head)]
    lines += [[_named(row), *(told(column, row) for column in columns)] for row in rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _named(subject: str) -> str:
    return SUBJECTS.get(subject, subject.replace("_", " "))
