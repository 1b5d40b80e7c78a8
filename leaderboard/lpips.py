"""LPIPS of held-out views (Zhang et al., CVPR 2018), version 0.1 with AlexNet: a figure beside the protocols' own.

The weights of its linear layers come with the package lpips (BSD-2-Clause; not imported, since it needs torchvision).
Those of the network below, torchvision's, are a download that the user names: no protocol can depend on them.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.benchmark import Benchmark
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.files.weights import parse_weights
from leaderboard.protocols.strict3 import STANDARD
from leaderboard.submission import read_render

SOURCE = "https://download.pytorch.org/models/alexnet-owt-7be5be79.pth"
LINEAR = "weights/v0.1/alex.pth"
_SHIFT, _SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
"""What pictures within -1 and 1 are normalised by, as in the authors' code: ImageNet's mean and deviation."""
_LAYERS = ((64, 3, 11), (192, 64, 5), (384, 192, 3), (256, 384, 3), (256, 256, 3))
"""Channels out and in, and side, of AlexNet's convolutions."""
_PLACES = (0, 3, 6, 8, 10)
"""Theirs among torchvision's `features`."""
_MAX_BYTES = 1 << 30


class Lpips:
    """The distance of two pictures: 0 for the same, about .7 for unlike ones."""

    def __init__(self, alexnet: Path, linear: Path | None = None) -> None:
        """`alexnet`: torchvision's file; `linear`: the package's when not given. Raises FreeArtError."""
        convolutions, weights = _read_weights(Path(alexnet)), _read_weights(linear or _find_linear())
        self._convolutions, self._linear = [], []
        for k, ((out, into, side), place) in enumerate(zip(_LAYERS, _PLACES, strict=True)):
            shapes = {f"features.{place}.weight": (out, into, side, side), f"features.{place}.bias": (out,)}
            self._convolutions.append([_require(convolutions, name, s, alexnet) for name, s in shapes.items()])
            self._linear.append(_require(weights, f"lin{k}.model.1.weight", (1, out, 1, 1), linear or _find_linear()))

    def distance(self, first: NDArray[np.uint8], second: NDArray[np.uint8]) -> float:
        """Of two pictures (height, width, 3) of the same size, 8 bits."""
        import torch

        with torch.no_grad():
            total = 0.0
            for a, b, weight in zip(self._features(first), self._features(second), self._linear, strict=True):
                a, b = (x / (x.square().sum(1, keepdim=True).sqrt() + 1e-10) for x in (a, b))
                total += float(((a - b).square() * weight).sum(1).mean())
        return total

    def _features(self, picture: NDArray[np.uint8]) -> list[Any]:
        import torch
        from torch.nn import functional

        shift, scale = (torch.tensor(values)[None, :, None, None] for values in (_SHIFT, _SCALE))
        x = torch.from_numpy(np.ascontiguousarray(picture)).permute(2, 0, 1)[None].float() / 127.5 - 1
        x, found = (x - shift) / scale, []
        for k, (weight, bias) in enumerate(self._convolutions):
            if k in (1, 2):
                x = functional.max_pool2d(x, 3, 2)
            x = functional.relu(
                functional.conv2d(x, weight, bias, stride=4 if k == 0 else 1, padding=2 if k < 2 else 1)
            )
            found.append(x)
        return found


def measure_views(
    results: Path, benchmark: Benchmark, network: Lpips, progress: Callable[[int, int], None] = lambda done, total: None
) -> dict[str, float | None]:
    """Sequence to the mean over its held-out views; None where no view shows the object.

    A view that is missing counts as an empty picture, whole pictures on strict-3's background are compared.
    """
    found: dict[str, float | None] = {}
    for done, name in enumerate(benchmark.sequences):
        progress(done, len(benchmark.sequences))
        camera, truth = read_sequence(benchmark.sequence(name)).camera, read_truth(benchmark.truth(name))
        values = []
        for i in range(len(read_sequence(benchmark.sequence(name)).queries)):
            mask = truth.query_mask(i)
            if not mask.any():
                continue
            empty = np.full((*mask.shape, 3), STANDARD.background, np.uint8)
            render, _ = read_render(results / name, "renders", i, camera.height, camera.width)
            picture = np.where(mask[..., None], truth.query_rgb(i), empty).astype(np.uint8)
            values.append(network.distance(picture, empty if render is None else render))
        found[name] = float(np.mean(values)) if values else None
    return found


def _find_linear() -> Path:
    spec = importlib.util.find_spec("lpips")
    if spec is None or spec.origin is None:
        raise FreeArtError("the package lpips is not installed: pip install --no-deps lpips==0.1.4")
    return Path(spec.origin).parent / LINEAR


def _read_weights(path: Path) -> dict[str, Any]:
    """What torch saved in a file, nothing executable. Raises FreeArtError."""
    if importlib.util.find_spec("torch") is None:
        raise FreeArtError("LPIPS needs torch: pip install 'freeart21[torch]'")
    return parse_weights(checked.read_bytes(path, _MAX_BYTES, checked.ANYWHERE), path)


def _require(weights: dict[str, Any], name: str, shape: tuple[int, ...], path: Path) -> Any:
    given = weights.get(name)
    if given is None or tuple(given.shape) != shape:
        got = "nothing" if given is None else " x ".join(map(str, given.shape))
        raise FreeArtError(f"{path}: '{name}' is {got}, expected {' x '.join(map(str, shape))}")
    return given.float()
