"""The objects that commands know by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from freeart21.errors import FreeArtError
from freeart21.joint import JointType


@dataclass(frozen=True)
class CatalogEntry:
    """One known object."""

    name: str
    category: str
    """Category name of PartNet-Mobility."""
    joint_type: JointType | None
    """Type of the scored joint; None when only the object's files state it."""
    size_m: float | None
    """Approximate diagonal, metres; None for PartNet-Mobility, whose unit is not metric (its diagonals are about 2)."""
    source: Literal["procedural", "partnet", "urdf"]
    joint: str | None
    """Name of the scored joint; None when the user must name it."""
    note: str = ""
    benchmark: str = ""
    """'FreeArt-21' for the objects of the official benchmark."""


_FREEART21: tuple[tuple[str, JointType, int, tuple[str, ...], str], ...] = (
    ("USB", "revolute", 0, ("100109", "100113", "102033"), ""),
    ("Lighter", "revolute", 0, ("100309", "100319", "100350"), ""),
    ("Stapler", "revolute", 1, ("102990", "103271", "103275"), ""),
    ("Phone", "prismatic", 0, ("103593", "103828", "103886"), "joint type assumed: not stated anywhere"),
    ("Scissors", "revolute", 0, ("10546", "10567", "11052"), ""),
    ("StorageFurniture", "prismatic", 0, ("45132", "45135", "48878"), ""),
    ("Display", "revolute", 0, ("4552", "4562", "4578"), ""),
)
"""Category, joint type, joint index, ids (FreeArtGS, configs/eval_joint_ids.yaml)."""

CATALOG: tuple[CatalogEntry, ...] = (
    CatalogEntry("swivel_usb", "USB", "revolute", 0.06, "procedural", "joint_0"),
    CatalogEntry("flip_cap_usb", "USB", "revolute", 0.065, "procedural", "joint_0"),
    CatalogEntry("folding_usb", "USB", "revolute", 0.07, "procedural", "joint_0"),
    CatalogEntry("flip_lighter", "Lighter", "revolute", 0.07, "procedural", "joint_0"),
    CatalogEntry("torch_lighter", "Lighter", "revolute", 0.076, "procedural", "joint_0"),
    CatalogEntry("folding_lighter", "Lighter", "revolute", 0.15, "procedural", "joint_0"),
    CatalogEntry("stapler", "Stapler", "revolute", 0.15, "procedural", "joint_1"),
    CatalogEntry("mini_stapler", "Stapler", "revolute", 0.08, "procedural", "joint_1"),
    CatalogEntry("long_arm_stapler", "Stapler", "revolute", 0.31, "procedural", "joint_1"),
    CatalogEntry("slider_phone", "Phone", "prismatic", 0.11, "procedural", "joint_0"),
    CatalogEntry("keyboard_phone", "Phone", "prismatic", 0.13, "procedural", "joint_0"),
    CatalogEntry("cover_phone", "Phone", "prismatic", 0.15, "procedural", "joint_0"),
    CatalogEntry("office_scissors", "Scissors", "revolute", 0.22, "procedural", "joint_0"),
    CatalogEntry("tailor_shears", "Scissors", "revolute", 0.29, "procedural", "joint_0"),
    CatalogEntry("craft_scissors", "Scissors", "revolute", 0.15, "procedural", "joint_0"),
    CatalogEntry("drawer_unit", "StorageFurniture", "prismatic", 0.45, "procedural", "joint_0"),
    CatalogEntry("nightstand", "StorageFurniture", "prismatic", 0.85, "procedural", "joint_0"),
    CatalogEntry("filing_cabinet", "StorageFurniture", "prismatic", 1.2, "procedural", "joint_0"),
    CatalogEntry("tilt_monitor", "Display", "revolute", 0.75, "procedural", "joint_0"),
    CatalogEntry("pivot_monitor", "Display", "revolute", 0.8, "procedural", "joint_0"),
    CatalogEntry("folding_display", "Display", "revolute", 0.4, "procedural", "joint_0"),
    *(
        CatalogEntry(name, category, joint_type, None, "partnet", f"joint_{index}", note, "FreeArt-21")
        for category, joint_type, index, names, note in _FREEART21
        for name in names
    ),
)
"""The procedural objects, then the 21 of FreeArt-21, whose files the user provides."""


def built_in_names() -> tuple[str, ...]:
    """The objects that need no files from outside."""
    return tuple(entry.name for entry in CATALOG if entry.source == "procedural")


def find(name: str, partnet: bool = False) -> CatalogEntry:
    """The entry of `name`. With `partnet`, any number is a PartNet-Mobility object, of unknown category and joint.

    Raises FreeArtError, listing the known objects, for any other name.
    """
    for entry in CATALOG:
        if entry.name == name:
            return entry
    if partnet and name.isdigit():
        return CatalogEntry(name, "unknown", None, None, "partnet", None)
    official = ", ".join(entry.name for entry in CATALOG if entry.source == "partnet")
    raise FreeArtError(
        f"unknown object '{name}'; objects: {', '.join(built_in_names())}; with --partnet-root also any "
        f"PartNet-Mobility id (those of FreeArt-21: {official})"
    )
