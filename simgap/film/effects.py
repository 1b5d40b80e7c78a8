"""Camera faults as effects, with parameters like those of a joint."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from freeart21.camera_faults import FAULTS, CameraFaults
from freeart21.effects.base import Effect, parameter

KNOTS = 7
"""Knots of a drift over the film: frames of each use alternate ten times or more, so each knot has some."""


_FIELDS: dict[str, tuple[str, ...]] = {
    "depth_scale": ("depth_scale",),
    "depth_offset": ("depth_offset",),
    "depth_curve": ("depth_curve",),
    "focal_length": ("focal",),
    "principal_point": ("centre_u", "centre_v"),
    "misregistration": ("depth_shift_u", "depth_shift_v", "depth_turn"),
    "depth_delay": ("depth_delay",),
    "axial_noise": ("noise", "noise_at"),
    "noise_growth": ("noise_growth",),
    "noise_grazing": ("noise_grazing",),
    "holes": ("holes",),
    "dark_holes": ("dark_share", "dark_level"),
    "grazing_holes": ("grazing_share", "grazing_angle"),
    "flying_pixels": ("flying_share", "flying_reach"),
    "exposure_drift": ("exposure",),
    "gamma_drift": ("gamma",),
}
"""Effect to its fields of `CameraFaults`; a drift's field becomes a parameter at every knot."""
DRIFTS = ("exposure", "gamma")


def _make_class(name: str, fields: tuple[str, ...]) -> type[Effect]:
    specs: list[tuple[str, type, Any]] = []
    for field in fields:
        fault = FAULTS[field]
        knots = range(KNOTS) if field in DRIFTS else ()
        meanings = {f"{field}_{k}": f"{fault.meaning} at {100 * k / (KNOTS - 1):.0f} % of the film" for k in knots}
        specs += [
            (own, float, parameter(fault.unit, fault.unit, fault.low, fault.high, meaning))
            for own, meaning in (meanings or {field: fault.meaning}).items()
        ]
    own = {"name": name, "kind": "sensing", "acts": "reading", "__doc__": f"{name} of a camera."}
    return dataclasses.make_dataclass(name, specs, bases=(Effect,), frozen=True, namespace=own)


EFFECTS: dict[str, type[Effect]] = {name: _make_class(name, fields) for name, fields in _FIELDS.items()}
"""Name to class."""


def parameters_of(name: str) -> tuple[str, ...]:
    """The names of an effect's parameters."""
    return tuple(EFFECTS[name].parameters())


def effect_of(name: str, values: Mapping[str, float]) -> Effect:
    """The effect with its parameters from `values`, clipped to their bounds."""
    specs = EFFECTS[name].parameters()
    return EFFECTS[name](**{k: float(np.clip(values[k], s.lower, s.upper)) for k, s in specs.items()})


def camera_of(effects: Iterable[Effect]) -> CameraFaults:
    """The camera with these faults and no others."""
    values = {name: getattr(effect, name) for effect in effects for name in effect.parameters()}
    for field in (drift for drift in DRIFTS if f"{drift}_0" in values):
        values[field] = tuple(values.pop(f"{field}_{k}") for k in range(KNOTS))
    return CameraFaults(**values)
