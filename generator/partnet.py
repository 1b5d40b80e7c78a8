"""Loads a PartNet-Mobility folder, real or written by `generator.partnet_writer`.

Properties of such folders (`tests/test_partnet.py` loads folders with each of them):

- Only mobility.urdf is read for geometry and joints: mobility_v2.json reverses some axes and uses degrees, and names
  and ids in semantics.txt and meta.json may differ. Other URDFs in the folder (ManiSkill's mobility_cvx,
  mobility_fixed) are ignored. Limits may be "-0.0".
- The link `base` is empty; the last joint fixes the real root to it and turns y-up meshes to z-up. Parts that are free
  in the world ("free" in semantics.txt, as a stapler's base) are fixed to it, too: the recorder moves the root.
- Links have no inertia, joints no dynamics, effort or velocity; collision shapes repeat the visual ones.
- Link frames are at the joints, meshes in the object's frame: their origin is minus the sum of joint origins.
- Visual names repeat. The origin of a slider may be zero, so that its pivot has no meaning.
- Joints may be continuous, without limits. A slider that also rotates is two joints with an empty link between them,
  and its limits may exclude zero: joints are held, and recorded, only within their limits.
- Meshes hold each face twice, once for each direction, and inner faces; units are not metric (the diagonal is about 2).
- Meshes, pictures and material libraries may be absent (see `generator.partnet_files`), and the folder may hold files
  that the URDF does not name.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.asset import read_semantics
from generator.urdf_object import LoadedObject, load_urdf

URDF_NAME = "mobility.urdf"

INCOMPLETE = frozenset(("10546",))
"""Objects of FreeArt-21 whose URDF names meshes that were never published because they have no faces (SAPIEN's issues
33 and 201): scissors. Others need `skip_missing`."""


def find_folder(name: str, root: Path) -> Path | None:
    """The folder of object `name`: ROOT/NAME or, as the data set unpacks, ROOT/dataset/NAME; None when absent."""
    return next((place for place in (root / name, root / "dataset" / name) if place.is_dir()), None)


def load(folder: Path, joint: str | None = None, skip_missing: bool = False) -> LoadedObject:
    """Load the object in `folder` with the named joint (or meta.json's scored joint, or the only movable one).

    Raises FreeArtError, in one line, as `generator.urdf_object.load_urdf`. `skip_missing` leaves absent mesh files out,
    as is always done for the objects in `INCOMPLETE`.
    """
    folder = Path(folder)
    urdf = folder / URDF_NAME
    if not urdf.is_file():
        raise FreeArtError(f"{folder} is not a PartNet-Mobility object: it has no {URDF_NAME}")
    meta = _meta(folder)
    skip = skip_missing or folder.resolve().name in INCOMPLETE
    loaded = load_urdf(urdf, joint or meta.get("scored_joint"), skip, folder, "PartNet-Mobility")
    return replace(
        loaded,
        category=str(meta.get("model_cat", "unknown")),
        semantics=read_semantics(folder / "semantics.txt"),
    )


def _meta(folder: Path) -> dict[str, Any]:
    path = folder / "meta.json"
    meta = checked.read_json(path) if path.is_file() else {}
    if not isinstance(meta.get("scored_joint", ""), str):
        raise FreeArtError(f"{path}: scored_joint is {meta['scored_joint']!r}, expected a joint's name")
    return meta
