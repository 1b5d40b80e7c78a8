"""What was found, in words that somebody with a camera in the hand understands."""

from __future__ import annotations

import numpy as np

from freeart21.camera_faults import CameraFaults

PLAIN: dict[str, str] = {
    "depth_scale": "depth reads a share too much",
    "depth_offset": "depth reads a constant too much",
    "depth_curve": "depth error grows with the distance squared",
    "focal_length": "the focal length is not what is told",
    "principal_point": "the principal point is not where it is told",
    "misregistration": "the depth picture does not lie on the colour picture",
    "depth_delay": "the depth picture is from another moment than the colour picture",
    "axial_noise": "each pixel's depth is noisy",
    "noise_growth": "the noise grows with the distance",
    "noise_grazing": "the noise grows on surfaces seen flat",
    "holes": "pixels are lost anywhere",
    "dark_holes": "dark surfaces lose their depth",
    "grazing_holes": "surfaces seen flat lose their depth",
    "flying_pixels": "pixels fly between surfaces at depth edges",
    "exposure_drift": "the exposure drifts",
    "gamma_drift": "the tone curve drifts",
    "missing_part": "the asset lacks a part",
}
UNITS: dict[str, str] = {
    "depth_scale": "",
    "depth_offset": "m",
    "depth_curve": "1/m",
    "noise": "m",
    "noise_at": "m",
    "noise_growth": "",
    "noise_grazing": "",
    "holes": "",
    "dark_share": "",
    "dark_level": "",
    "grazing_share": "",
    "grazing_angle": "rad",
    "flying_share": "",
    "flying_reach": "px",
    "depth_shift_u": "px",
    "depth_shift_v": "px",
    "depth_turn": "rad",
    "focal": "",
    "centre_u": "px",
    "centre_v": "px",
    "depth_delay": "s",
    "exposure": "stops",
    "gamma": "",
}


def told(name: str, c: CameraFaults) -> str:
    """One effect with its size."""
    match name:
        case "depth_scale":
            return f"depth reads {100 * abs(c.depth_scale):.2g} % too {_much(c.depth_scale)}"
        case "depth_offset":
            return f"depth reads {1e3 * abs(c.depth_offset):.2g} mm too {_much(c.depth_offset)} at any distance"
        case "depth_curve":
            size = f"{1e3 * abs(c.depth_curve):.2g} mm too {_much(c.depth_curve)}"
            return f"depth reads {size} at 1 m, growing as the distance squared"
        case "focal_length":
            return f"the focal length is {100 * abs(c.focal):.2g} % {'longer' if c.focal > 0 else 'shorter'} than told"
        case "principal_point":
            return f"the principal point is {_way(c.centre_u, c.centre_v)} of where it is told"
        case "misregistration":
            turn = np.degrees(c.depth_turn)
            turned = f", turned by {turn:.2g} degrees" if abs(turn) >= 0.1 else ""
            return f"the depth picture lies {_way(c.depth_shift_u, c.depth_shift_v)} of the colour picture{turned}"
        case "depth_delay":
            late = "older" if c.depth_delay > 0 else "younger"
            return f"the depth picture is {1e3 * abs(c.depth_delay):.2g} ms {late} than the colour picture"
        case "axial_noise":
            return f"each pixel's depth has noise of {1e3 * c.noise:.2g} mm at {c.noise_at:.2g} m"
        case "noise_growth":
            return f"it grows with the distance to the power of {c.noise_growth:.2g}"
        case "noise_grazing":
            return f"it grows on surfaces seen flat, as cos to the power of -{c.noise_grazing:.2g}"
        case "holes":
            return f"{100 * c.holes:.2g} % of the pixels have no depth, wherever they are"
        case "dark_holes":
            level = 100 * c.dark_level
            return f"surfaces darker than {level:.0f} % lose {100 * c.dark_share:.0f} % of their depth pixels"
        case "grazing_holes":
            angle = np.degrees(c.grazing_angle)
            share = 100 * c.grazing_share
            return f"surfaces seen flatter than {angle:.0f} degrees lose {share:.0f} % of their depth pixels"
        case "flying_pixels":
            share = 100 * c.flying_share
            return f"{share:.0f} % of the pixels within {c.flying_reach:g} px of a depth edge fly between both"
        case "exposure_drift":
            return f"the exposure drifts by {np.ptp(c.exposure):.2g} stops over the film"
        case "gamma_drift":
            return f"the tone curve's exponent drifts by {np.ptp(c.gamma):.2g} over the film"
    return PLAIN[name]


def _much(value: float) -> str:
    return "much" if value > 0 else "little"


def _way(u: float, v: float) -> str:
    ways = [
        f"{abs(u):.1f} px {'right' if u > 0 else 'left'}" if abs(u) >= 0.05 else "",
        f"{abs(v):.1f} px {'below' if v > 0 else 'above'}" if abs(v) >= 0.05 else "",
    ]
    return " and ".join(w for w in ways if w) or "within 0.05 px"


def listed(parts: list[str]) -> str:
    """'a, b and c'."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
