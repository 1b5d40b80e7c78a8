"""Learned networks: their weights, read without running anything that they hold, their code, and their pictures."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.weights import first_line, parse_weights

INSTALL = "pip install 'freeart21[priors]'"
FOLDER = "FREEART21_WEIGHTS"
"""Environment variable: the folder of the weights that the user brings, under the names that they are published by."""
MAX_BYTES = 8 << 30
"""Largest file of weights."""


@dataclass(frozen=True)
class PackagedWeights:
    """A file of weights inside an installed package.

    One content is accepted, so that the same code gives the same result: the code is part of the cache's keys.
    """

    package: str
    """Name by which it is imported."""
    file: str
    """Path in the package."""
    sha256: str
    """Of the file, hexadecimal."""

    def read(self) -> dict[str, Any]:
        """The tensors by name; FreeArtError when the package is missing or holds another file."""
        require_packages("torch", "kornia", self.package)
        spec = importlib.util.find_spec(self.package)
        assert spec is not None and spec.submodule_search_locations
        path = Path(next(iter(spec.submodule_search_locations))) / self.file
        data = checked.read_bytes(path, MAX_BYTES, checked.ANYWHERE)
        found = hashlib.sha256(data).hexdigest()
        if found != self.sha256:
            raise FreeArtError(
                f"{path} has SHA-256 {found[:12]}, expected {self.sha256[:12]}: another release's weights"
            )
        return parse_weights(data, path)


@dataclass(frozen=True)
class BroughtWeights:
    """A file of weights that its authors publish and that the user brings."""

    file: str
    """The published name."""
    source: str
    """Where it is to be had."""

    def is_there(self) -> bool:
        """Whether the folder that FREEART21_WEIGHTS names has the file."""
        folder = os.environ.get(FOLDER)
        return bool(folder) and checked.is_there(Path(str(folder)) / self.file)

    def path(self) -> Path:
        """The file in the folder that FREEART21_WEIGHTS names; FreeArtError says where it is to be had."""
        folder = os.environ.get(FOLDER)
        if not folder:
            raise FreeArtError(f"{self.file} is needed: get it from {self.source}, and set {FOLDER} to its folder")
        path = Path(folder) / self.file
        if not checked.is_there(path):
            raise FreeArtError(f"{path} is missing: get it from {self.source}")
        return path

    def read(self) -> dict[str, Any]:
        """The tensors by name; FreeArtError when the file is missing or holds anything else."""
        path = self.path()
        require_packages("torch")
        return parse_weights(checked.read_bytes(path, MAX_BYTES, checked.ANYWHERE), path)


@dataclass(frozen=True)
class Checkout:
    """The code of a network that is in no package: a public repository's clone in the folder of FREEART21_WEIGHTS."""

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


def require_packages(*names: str) -> None:
    """Raises FreeArtError, with the line that installs it, when a package cannot be found."""
    for name in names:
        if importlib.util.find_spec(name) is None:
            raise FreeArtError(f"the package {name} is not installed: {INSTALL}")


def load_into(network: Any, weights: dict[str, Any], what: str, derived: tuple[str, ...] = ()) -> Any:
    """`network` with `weights`, ready for inference; FreeArtError when a name or a shape differs.

    `derived` are buffers that follow from the settings of the network, which not every file holds.
    """
    own = network.state_dict()
    try:
        network.load_state_dict({**{name: own[name] for name in derived}, **weights})
    except RuntimeError as error:
        raise FreeArtError(f"{what} does not fit its network: {' '.join(str(error).split())[:200]}") from None
    return network.eval()


@contextmanager
def inference() -> Iterator[None]:
    """Without gradients, and on one thread: the same bits on any number of cores."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.inference_mode():
            yield
    finally:
        torch.set_num_threads(threads)


def enlarge(picture: NDArray[np.uint8], enlargement: float, stride: int) -> NDArray[np.uint8]:
    """A picture (h, w, 3) `enlargement` times as large, each side rounded to a multiple of `stride` pixels."""
    sides = [max(round(side * enlargement / stride), 1) * stride for side in picture.shape[:2]]
    return np.asarray(cv2.resize(picture, (sides[1], sides[0]), interpolation=cv2.INTER_LINEAR), np.uint8)


def to_tensor(picture: NDArray[np.uint8]) -> Any:
    """(1, 3, h, w) from 0 to 1, of a picture (h, w, 3) in RGB."""
    import torch

    return torch.from_numpy(np.ascontiguousarray(picture)).permute(2, 0, 1)[None].float() / 255


def to_crop(at: NDArray[Any], picture: NDArray[np.uint8], enlarged: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Columns and rows (m, 2) in `enlarged` as those in `picture`; whole numbers are pixel centres in both."""
    ratio = np.array(picture.shape[1::-1]) / np.array(enlarged.shape[1::-1])
    return np.asarray((np.asarray(at, float) + 0.5) * ratio - 0.5)
