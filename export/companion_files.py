"""Files derived from URDF, MJCF and asset.json: USD, loaders, preview.png."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from export.loaders import write_loaders
from export.preview import write_preview
from freeart21.asset import Asset
from freeart21.errors import FreeArtError

USD = "object.usdc"


def write_companion_files(folder: Path, asset: Asset, with_usd: bool | None = None) -> None:
    """Write them into `folder`, which holds the finished `asset`.

    `with_usd` None writes USD where usd-core is installed; True raises FreeArtError where it is not.
    """
    installed = importlib.util.find_spec("pxr") is not None
    if with_usd and not installed:
        raise FreeArtError("usd-core is not installed, which writes USD: pip install 'freeart21[usd]'")
    if installed if with_usd is None else with_usd:
        from export.usd import write_usd

        write_usd(folder / USD, asset)
    write_loaders(folder, asset)
    write_preview(folder, asset)
