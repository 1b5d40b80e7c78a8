"""What a camera may do to its pictures, as effects with named parameters like those of a joint."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from freeart21.camera_faults import BOUNDS, CameraFaults
from freeart21.effects.base import Effect, parameter

KNOTS = 7
"""Of a drift's curve over the film: frames of each kind take turns ten times or more, so that each knot has some."""


def _drift(field: str, unit: str, what: str) -> dict[str, tuple[str, str]]:
    return {f"{field}_{k}": (unit, f"{what} at {100 * k / (KNOTS - 1):.0f} % of the film") for k in range(KNOTS)}


_PARAMETERS: dict[str, dict[str, tuple[str, str]]] = {
    "depth_scale": {"depth_scale": ("1", "share of itself that depth reads too much")},
    "depth_offset": {"depth_offset": ("m", "what depth reads too much at any distance")},
    "depth_curve": {"depth_curve": ("1/m", "what depth reads too much, by the square of the distance")},
    "focal_length": {"focal": ("1", "share by which the focal length is longer than given")},
    "principal_point": {
        "centre_u": ("px", "of the principal point, right of where it is given"),
        "centre_v": ("px", "below it"),
    },
    "misregistration": {
        "depth_shift_u": ("px", "of the depth picture, right of the colour picture"),
        "depth_shift_v": ("px", "below it"),
        "depth_turn": ("rad", "clockwise about the principal point"),
    },
    "depth_delay": {"depth_delay": ("s", "by which the depth picture is older than the colour picture")},
    "axial_noise": {
        "noise": ("m", "standard deviation of each pixel's depth"),
        "noise_at": ("m", "distance at which it is that"),
    },
    "noise_growth": {"noise_growth": ("1", "power of the distance that the noise grows by")},
    "noise_grazing": {"noise_grazing": ("1", "power of 1 / cos(angle of incidence) that the noise grows by")},
    "holes": {"holes": ("1", "share of all pixels without depth")},
    "dark_holes": {
        "dark_share": ("1", "share of their pixels that dark surfaces lose"),
        "dark_level": ("1", "brightness, 0 to 1, below which they do"),
    },
    "grazing_holes": {
        "grazing_share": ("1", "share of their pixels that surfaces seen flat lose"),
        "grazing_angle": ("rad", "angle of incidence above which they do"),
    },
    "flying_pixels": {
        "flying_share": ("1", "share of the pixels at a depth edge that lie between both surfaces"),
        "flying_reach": ("px", "distance to the edge within which they do"),
    },
    "exposure_drift": _drift("exposure", "stops", "exposure"),
    "gamma_drift": _drift("gamma", "1", "exponent of the tone curve, less 1,"),
}
"""Effect to its parameters, fields of `CameraFaults` (of a drift its knots): SI unit (or pixels), meaning."""


def _made(name: str, specs: Mapping[str, tuple[str, str]]) -> type[Effect]:
    fields = [
        (field, float, parameter(unit, unit, *BOUNDS.get(field, (-20.0, 20.0)), meaning))
        for field, (unit, meaning) in specs.items()
    ]
    own = {"name": name, "kind": "sensing", "acts": "reading", "__doc__": f"{name} of a camera."}
    return dataclasses.make_dataclass(name, fields, bases=(Effect,), frozen=True, namespace=own)


EFFECTS: dict[str, type[Effect]] = {name: _made(name, specs) for name, specs in _PARAMETERS.items()}
"""Name to class."""


def parameters_of(name: str) -> tuple[str, ...]:
    """The names of an effect's parameters."""
    return tuple(_PARAMETERS[name])


def effect_of(name: str, values: Mapping[str, float]) -> Effect:
    """The effect with its parameters out of `values`, within their bounds."""
    specs = EFFECTS[name].parameters()
    return EFFECTS[name](**{k: float(np.clip(values[k], s.lower, s.upper)) for k, s in specs.items()})


def camera_of(effects: Mapping[str, Effect] | list[Effect]) -> CameraFaults:
    """The camera that has these effects and is else without fault."""
    every = list(effects.values()) if isinstance(effects, Mapping) else effects
    values = {k: v for effect in every for k, v in dataclasses.asdict(effect).items()}  # type: ignore[call-overload]
    drifts: dict[str, Any] = {
        field: tuple(values.pop(f"{field}_{k}") for k in range(KNOTS))
        for field in ("exposure", "gamma")
        if f"{field}_0" in values
    }
    return CameraFaults(**values, **drifts)
