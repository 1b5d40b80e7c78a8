"""Materials: density, friction and restitution."""

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


TABLE: dict[str, Material] = {
    "plastic": Material(1050.0, 0.35, 0.4),
    "wood": Material(700.0, 0.4, 0.4),
    "steel": Material(7850.0, 0.5, 0.5),
    "aluminium": Material(2700.0, 0.45, 0.4),
    "glass": Material(2500.0, 0.4, 0.6),
    "rubber": Material(1200.0, 0.9, 0.7),
    "cardboard": Material(700.0, 0.4, 0.2),
}
"""Round figures without a source. Densities: ABS and polystyrene, beech and birch plywood, carbon steel, pure
aluminium, soda-lime glass, filled rubber, solid board (corrugated board is a third of it). Friction and restitution
differ by a third and more with finish, dirt and shape: they say which of two is the more slippery or the livelier."""
DENSITIES = {name: material.density for name, material in TABLE.items()}
"""kg/m^3."""
DEFAULT: MaterialName = "plastic"
"""Assumed when nothing is given: most hand-held objects are moulded plastic."""
