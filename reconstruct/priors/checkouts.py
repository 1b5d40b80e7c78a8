"""Networks whose code is not in a package: of a clone that the user keeps beside the weights."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from freeart21.errors import FreeArtError
from freeart21.files.weights import first_line
from reconstruct.priors.weights import FOLDER, require_packages


@dataclass(frozen=True)
class Checkout:
    """A clone of a public repository, in the folder that FREEART21_WEIGHTS names."""

    folder: str
    """Its name there."""
    source: str
    """Where it is to be had."""

    def path(self) -> Path:
        """The folder; FreeArtError names the command that gets it."""
        require_packages("torch")
        place = Path(os.environ.get(FOLDER) or f"${FOLDER}") / self.folder
        if not place.is_dir():
            raise FreeArtError(f"the network's code is needed: git clone {self.source} {place} (set {FOLDER})")
        return place.absolute()

    def load_module(self, name: str) -> ModuleType:
        """The module `name`: of an installed package, if there is one, or of the clone."""
        try:
            installed = importlib.util.find_spec(name) is not None
        except ImportError:
            installed = False
        place = None if installed else str(self.path())
        if place:
            sys.path.insert(0, place)
        try:
            return importlib.import_module(name)
        except ImportError as error:
            raise FreeArtError(f"{place or name} cannot be imported: {first_line(error)}") from None
        finally:
            if place:
                sys.path.remove(place)

    def load_hub(self, entry: str) -> Any:
        """The network of an entry of the clone's hubconf.py, without weights."""
        import torch

        place = self.path()
        try:
            return torch.hub.load(str(place), entry, source="local", pretrained=False)
        except (ImportError, OSError, RuntimeError) as error:
            raise FreeArtError(f"{place} has no network {entry}: {first_line(error)}") from None
