"""Materials and their densities."""

from __future__ import annotations

from typing import Literal, get_args

Material = Literal["plastic", "wood", "steel", "aluminium", "glass", "rubber", "cardboard"]
MATERIALS: tuple[str, ...] = get_args(Material)
DENSITIES: dict[str, float] = {
    "plastic": 1050.0,
    "wood": 700.0,
    "steel": 7850.0,
    "aluminium": 2700.0,
    "glass": 2500.0,
    "rubber": 1200.0,
    "cardboard": 700.0,
}
"""kg/m^3. Round figures without a source: ABS and polystyrene, beech and birch plywood, carbon steel, pure aluminium,
soda-lime glass, filled rubber, solid board (corrugated board is a third of it)."""
DEFAULT: Material = "plastic"
"""Assumed when nothing is given: most hand-held objects are moulded plastic."""
