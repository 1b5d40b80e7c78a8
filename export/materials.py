"""Materials: density, friction, restitution, and how thick walls of them are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

MaterialName = Literal["plastic", "wood", "steel", "aluminium", "glass", "rubber", "cardboard"]
MATERIALS: tuple[str, ...] = get_args(MaterialName)


@dataclass(frozen=True)
class Material:
    """What a part is made of."""

    density: float
    """kg/m^3."""
    friction: float
    """Coefficient of sliding on a dry surface of the same kind or of wood."""
    restitution: float
    """Speed after a fall from hand height onto a hard floor over the speed before."""
    walls: tuple[float, float]
    """m: the thinnest and the thickest walls and panels that things are usually made of."""

    def usual_wall(self, size: float) -> float:
        """Thickness, m, of the walls of a hollow part of diagonal `size`, m."""
        return min(max(WALL_SHARE * size, self.walls[0]), self.walls[1])


TABLE: dict[str, Material] = {
    "plastic": Material(1050.0, 0.35, 0.4, (1.1e-3, 3.6e-3)),
    "wood": Material(700.0, 0.4, 0.4, (9e-3, 19e-3)),
    "steel": Material(7850.0, 0.5, 0.5, (0.6e-3, 2e-3)),
    "aluminium": Material(2700.0, 0.45, 0.4, (0.8e-3, 3e-3)),
    "glass": Material(2500.0, 0.4, 0.6, (2e-3, 6e-3)),
    "rubber": Material(1200.0, 0.9, 0.7, (1e-3, 5e-3)),
    "cardboard": Material(700.0, 0.4, 0.2, (0.5e-3, 7e-3)),
}
"""Round figures without a source. Densities: ABS and polystyrene, beech and birch plywood, carbon steel, pure
aluminium, soda-lime glass, filled rubber, solid board (corrugated board is a third of it). Friction and restitution
differ by a third and more with finish, dirt and shape: they say which of two is the more slippery or the livelier.
Walls: of ABS as moulders recommend them (0.045 to 0.140 inch, Protolabs, "Improving part design with uniform wall
thickness"), boards of cabinets (drawer bottoms of 9 mm, sides of 3/4 inch); of the others round figures, too."""
WALL_SHARE = 0.014
"""Thickness of a wall over the diagonal of its part: the median of 44 parts of recorded objects whose rims show it;
half of them have 0.010 to 0.024."""
DENSITIES = {name: material.density for name, material in TABLE.items()}
"""kg/m^3."""
DEFAULT: MaterialName = "plastic"
"""Assumed when nothing is given: most hand-held objects are moulded plastic."""
