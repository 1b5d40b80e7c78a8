"""Objects as folders that a simulator can load: procedural ones are written, PartNet-Mobility ones made readable.

Part of the package's interface for other packages, besides `simulate`: `export.maniskill` uses it.
"""

from __future__ import annotations

from pathlib import Path

from generator import objects
from generator.partnet_files import sapien_urdf
from generator.partnet_writer import write_partnet

__all__ = ["object_folder", "sapien_urdf"]


def object_folder(name: str, seed: int, place: Path) -> Path:
    """The folder place/NAME-sSEED of the catalog's procedural object `name`; it is written unless it exists.

    Raises FreeArtError when the catalog holds no procedural object of that name.
    """
    folder = Path(place) / f"{name}-s{seed}"
    if not (folder / "mobility.urdf").is_file():
        write_partnet(objects.build(name, seed), folder)
    return folder
