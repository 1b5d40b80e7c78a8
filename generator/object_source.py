"""Where one object comes from: our models, a PartNet-Mobility folder, or a URDF."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from freeart21 import catalog
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.urdf import MAX_URDF_BYTES
from generator import objects, partnet, urdf_object
from generator.model import ObjectModel
from generator.motion import PRESETS
from generator.partnet_writer import write_partnet
from generator.settings import RecordSettings
from generator.urdf_object import LoadedObject

ACCESS = "https://sapien.ucsd.edu/downloads"
"""Where to ask for PartNet-Mobility."""


@dataclass(frozen=True)
class ObjectSource:
    """One object, not yet loaded."""

    entry: catalog.CatalogEntry
    """The catalog's, or a new one for a URDF or a PartNet-Mobility id."""
    settings: RecordSettings
    """Seed and preset of a procedural object, and where files are."""
    urdf: Path | None = None

    @property
    def joint(self) -> str | None:
        """Scored joint; None: the only movable one."""
        return self.settings.joint or self.entry.joint

    def load(self, place: Path) -> LoadedObject:
        """Load the object.

        The folder of a procedural object is written in `place` unless it exists; it gets the preset's size. Other
        files are the user's.
        """
        folder, s = place / self.entry.name, self.settings
        if self.urdf is not None:
            return urdf_object.load_urdf(self.urdf, self.joint, s.skip_missing, s.root)
        if self.entry.source != "procedural":
            folder = find_partnet_folder(self.entry.name, s.partnet_root)
        elif not folder.is_dir():
            write_partnet(self.build(), folder)
        return partnet.load(folder, self.joint, s.skip_missing)

    def build(self) -> ObjectModel:
        """The model of a procedural object."""
        model, diagonal = objects.build(self.entry.name, self.settings.seed), PRESETS[self.settings.preset].diagonal_m
        return model if diagonal is None else model.scaled(diagonal / model.diagonal)


def find_object(name: str, settings: RecordSettings) -> ObjectSource:
    """The source of `name`: an object of the catalog, the path of a URDF or, with a root, a PartNet-Mobility id.

    Raises FreeArtError when the name is unknown, or the URDF is missing.
    """
    urdf = settings.urdf
    if urdf is None and name.lower().endswith(urdf_object.URDF_ENDINGS):
        urdf = checked.require_file(Path(name), MAX_URDF_BYTES, checked.ANYWHERE)
        name = urdf_object.object_name(Path(name))
    if urdf is None:
        return ObjectSource(catalog.find(name, partnet=settings.partnet_root is not None), settings)
    return ObjectSource(catalog.CatalogEntry(name, "unknown", None, None, "urdf", None), settings, urdf)


def find_partnet_folder(name: str, root: Path | None) -> Path:
    """The folder of the PartNet-Mobility object `name`; FreeArtError when it is absent, with where to ask for it."""
    if root is None:
        raise FreeArtError(
            f"object '{name}' is from PartNet-Mobility: give the folder that holds {name} as --partnet-root; "
            f"access to the dataset: {ACCESS}"
        )
    folder = partnet.find_folder(name, root)
    if folder is None:
        raise FreeArtError(
            f"PartNet-Mobility object {name} is not in {root}; ask for access to the dataset at {ACCESS} and unpack it "
            f"so that {root / name / partnet.URDF_NAME} exists"
        )
    return folder
