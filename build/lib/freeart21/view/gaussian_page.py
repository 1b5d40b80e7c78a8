"""The page of one file of Gaussians: the object at joint state zero, and nothing to move it by."""

from __future__ import annotations

import numpy as np

from freeart21.gaussians import Gaussians
from freeart21.view.document import MOVING, REFERENCE, document
from freeart21.view.scene import Layer, Link, Scene, gathered, scene_section
from freeart21.view.splats import SplatLayers
from freeart21.view.tables import table_section

MAX_SPLATS_ALONE = 350_000
"""Gaussians in such a page, 11 MB of it; of 500,000, textures would be larger than WebGL 2 promises."""


def gaussians_page(name: str, gaussians: Gaussians) -> str:
    """The page of one Gaussian at least."""
    n, moving = len(gaussians), int((gaussians.part_weights < 0.5).sum())
    rows = [
        ("Gaussians", f"{n:,}"),
        ("Extent, units of the file", " x ".join(f"{x:.3g}" for x in np.ptp(gathered(gaussians.means), 0))),
    ]
    if _parted(gaussians):
        rows += [("Of the reference part", f"{n - moving:,}"), ("Of the moving part", f"{moving:,}")]
        rows.append(("Joint", "not in this file: parts stand at state zero; the page of a result has a slider"))
    lit = "the same from everywhere"
    if gaussians.light is not None:
        lit = f"as before the recording camera, which is the eye here ({len(gaussians.light)} spherical harmonics)"
    facts = table_section("Gaussians", [*rows, ("Light", lit)])
    section = scene_section(gaussians_scene(gaussians), "Gaussians", "full")
    return document(name, [section, facts], "Gaussians", [f"{n:,} Gaussians"])


def gaussians_scene(gaussians: Gaussians) -> Scene:
    """Gaussians alone, y down and z away from the eye as the first camera of a video has them."""
    layers: tuple[Layer, ...] = (Layer("Gaussians", REFERENCE),)
    if _parted(gaussians):
        layers = (Layer("reference part", REFERENCE), Layer("moving part", MOVING))
    return Scene(
        links=(Link(-1),),
        sliders=(),
        layers=layers,
        surfaces=(),
        up=np.array([0.0, -1.0, 0.0]),
        towards_viewer=np.array([0.45, -0.4, -1.0]),
        splats=SplatLayers(gaussians, (0, 0), (0, len(layers) - 1), MAX_SPLATS_ALONE),
    )


def _parted(gaussians: Gaussians) -> bool:
    return bool((gaussians.part_weights < 1).any())
