"""Numbers and poses as a URDF writes them."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.se3 import Array


def numbers(text: str, n: int = 3) -> Array:
    """(n,) numbers of an attribute; FreeArtError when it is not just these."""
    try:
        found = np.array([float(word) for word in text.split()])
    except ValueError:
        found = np.zeros(0)
    if len(found) != n or not np.isfinite(found).all():
        raise FreeArtError(f"'{text}' is not {n} finite numbers")
    return found


def told(element: ET.Element, path: str, attribute: str, default: str = "") -> str:
    """An attribute of the element at `path` below `element`, or the default when either is not there."""
    found = element.find(path)
    return default if found is None else found.get(attribute, default)


def origin_pose(element: ET.Element) -> Array:
    """(4, 4) the pose that an element's <origin> says; rpy are fixed-axis x, y, z angles."""
    roll, pitch, yaw = numbers(told(element, "origin", "rpy", "0 0 0"))
    R = se3.exp_so3([0, 0, yaw]) @ se3.exp_so3([0, pitch, 0]) @ se3.exp_so3([roll, 0, 0])
    return se3.pose(R, numbers(told(element, "origin", "xyz", "0 0 0")))
