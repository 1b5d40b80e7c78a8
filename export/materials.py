"""What parts may be made of, and how heavy that is: video tells no material."""

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
"""kg/m^3, rounded: ABS and polystyrene 1040 to 1060, beech and birch ply 680 to 720, carbon steel, pure aluminium,
soda-lime glass, filled rubber 1100 to 1300, solid board (corrugated is a third of it)."""
DEFAULT: Material = "plastic"
"""What people hold in their hands is most often moulded."""
