"""What an asset carries beside URDF and MJCF, made from these and asset.json: USD, loaders, LOSSES.md, a picture."""

from __future__ import annotations

from pathlib import Path

from export import usd
from export.loaders import write_loaders
from export.losses import write_losses
from export.preview import write_preview
from freeart21.asset import Asset

USD = "object.usdc"


def write_beside(folder: Path, asset: Asset, with_usd: bool | None = None) -> None:
    """Write them into `folder`, where `asset` stands finished.

    `with_usd` None writes USD where usd-core is installed; True raises FreeArtError where it is not.
    """
    if usd.available() if with_usd is None else with_usd:
        usd.write_usd(folder / USD, asset)
    write_loaders(folder, asset)
    write_losses(folder, asset)
    write_preview(folder, asset)
