"""Loaders shipped with an asset: each restores what one engine drops of its joint.

The files `load_*.py` are copied into assets as they are. They import nothing of this package; the asset's numbers are
in `joint.json` beside them.
"""

from __future__ import annotations

from pathlib import Path

from export.model import WORLD
from freeart21.asset import Asset
from freeart21.files import atomic
from freeart21.files.urdf import read_urdf
from freeart21.reconstruction import describe_trust

FOLDER = "loaders"
SCHEMA = "freeart21/loaders/3"
ENGINES = ("sapien", "mujoco", "pybullet", "drake")
SURFACE = ("friction", "restitution")
"""Of a link's surface."""
WORDS = ("damping", "friction", "armature", "stiffness")
"""Joint parameters that effects can be (`Effect.joint_word`)."""


def write_loaders(folder: Path, asset: Asset) -> None:
    """Write `loaders/` into an asset's folder, whose URDF and effects are final."""
    (folder / FOLDER).mkdir(exist_ok=True)
    for engine in ENGINES:
        name = f"load_{engine}.py"
        atomic.write_bytes(folder / FOLDER / name, Path(__file__).with_name(name).read_bytes())
    atomic.write_json(folder / FOLDER / "joint.json", joint_numbers(asset))


def joint_numbers(asset: Asset) -> dict[str, object]:
    """Numbers of the asset's joint for a loader, SI; effects are added up by kind."""
    urdf = read_urdf(asset.urdf)
    joint = urdf.joints[asset.joint]
    effects = asset.effects.get(asset.joint, ())
    terms = [(effect.joint_word, effect.values()) for effect in effects]
    sizes = {word: sum(values[0] for own, values in terms if own == word) for word in WORDS}
    pull = sum(values[0] * values[1] for own, values in terms if own == "stiffness")
    return {
        "schema": SCHEMA,
        "urdf": asset.urdf.name,
        "mjcf": asset.urdf.with_suffix(".xml").name,
        "base": find_base(asset),
        "base_link": joint.parent,
        "joint": asset.joint,
        "type": joint.joint_type,
        **sizes,
        "rest": pull / sizes["stiffness"] if sizes["stiffness"] else 0.0,
        "velocity": joint.velocity,
        "surfaces": _read_surfaces(asset),
        "effects": {effect.name: effect.joint_word for effect in sorted(effects, key=lambda effect: effect.name)},
        "trust": describe_trust(asset.trust),
    }


def _read_surfaces(asset: Asset) -> dict[str, dict[str, float]]:
    """Friction and restitution of each link, from asset.json; empty where it states none."""
    found = {}
    for part, link in (("reference", asset.reference_link), ("moving", asset.moving_link)):
        surface = asset.facts("parts", part, "surface")
        if all(isinstance(surface.get(key), int | float) for key in SURFACE):
            found[link] = {key: float(surface[key]) for key in SURFACE}
    return found


def find_base(asset: Asset) -> str:
    """ "free" or "fixed": the URDF of a fixed base has the root link `world`."""
    return "fixed" if read_urdf(asset.urdf).root == WORLD else "free"
