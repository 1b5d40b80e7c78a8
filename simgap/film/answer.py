"""From what was found to the answer: what the confirming frames confirm, what cannot be told, and what is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from freeart21.camera_faults import CameraFaults, with_values
from freeart21.se3 import Array
from simgap.film.choose import LEAST_SHARE, Tried, benjamini_hochberg, sign_flip_p, standard_error
from simgap.film.errors import film_maps
from simgap.film.found import Found
from simgap.film.geometry import LEAST_DEPTH, thinned
from simgap.film.library import Effect
from simgap.film.linear import LinearFit, density, fitted, left
from simgap.film.verdict import FilmGap, FilmVerdict, Named, Parameter, Where
from simgap.film.where import LEVEL, FilmMap
from simgap.film.words import PLAIN, UNITS, listed, told

ROUNDED_PX = 0.41
"""Root mean square of the difference of two outlines that are both rounded to whole pixels: 1 / sqrt(6)."""
NINETY = 1.645
KEEPS = 0.5
"""Share by which an effect's size may change beside a nameless rival that explains more. Not measured."""
LEFT = 0.1
"""Share of a gap that may be left without a word. Not measured."""
TWICE = 2.0
"""Floors, or times its gain, from which on what a nameless rival explains is no more what a name explains."""
HALF = 0.5
"""Share of its gap that a name leaves, on confirming frames, where such a rival explains twice as much: then it is not
what is there."""


@dataclass(frozen=True)
class _Claim:
    """An effect before it is confirmed."""

    name: str
    gains: Array
    values: dict[str, Any]
    spreads: dict[str, float]
    certain: bool
    refused: str = ""
    """Why it is not named, whatever it gains."""


def answered(found: Found) -> FilmVerdict:
    """The answer."""
    claims = [*_geometric(found), *_counted(found), *_coloured(found)]
    p = np.array([sign_flip_p(c.gains) for c in claims])
    adjusted = benjamini_hochberg(p) if len(p) else p
    named, camera, notes = [], CameraFaults(), list[str]()
    for claim, value in sorted(zip(claims, adjusted, strict=True), key=lambda c: -float(c[0].gains.mean())):
        if claim.refused or value > LEVEL or claim.gains.mean() <= 0:
            unsure = f"{PLAIN[claim.name]}: not confirmed by the frames kept back (p = {value:.2g})"
            notes.append(claim.refused or unsure)
            continue
        parameters = {k: _parameter(k, v, claim.spreads.get(k)) for k, v in claim.values.items()}
        named.append(Named(claim.name, parameters, float(value), float(claim.gains.mean()), claim.certain))
        if claim.certain:
            camera = with_values(camera, claim.values)
    names = [n.name for n in named]
    gaps = _gaps(found, names)
    maps = film_maps(found)
    remains = _left(found, gaps, names)
    rivals = _rivals(found, names)
    if named or found.part is not None:
        verdict: Any = "ambiguous" if rivals else "named"
    else:
        verdict = "unexplained" if remains else "no_gap"
    best = CameraFaults()
    for claim in claims:
        best = with_values(best, claim.values) if claim.name in names else best
    return FilmVerdict(
        verdict,
        _sentence(verdict, named, rivals, found, remains, best),
        tuple(named),
        rivals,
        found.part,
        _cannot_tell(found),
        tuple(remains),
        tuple(
            Where(m.what, m.over, m.adjusted, _place(m))
            for m in maps
            if m.adjusted <= LEVEL and m.flagged.any() and _shows(m.what, gaps, found)
        ),
        tuple(gaps),
        {k: [int(f) for f in found.frames[i]] for k, i in zip(("fit", "choose", "confirm"), found.split, strict=True)},
        camera,
        found.scene.placed.source,
        tuple(dict.fromkeys(notes)),
    )


def _shows(what: str, gaps: Sequence[FilmGap], found: Found) -> bool:
    """Whether the gap that a map is of is above its floor: smaller ones are real, too, but nothing to speak of."""
    gap = next((g for g in gaps if g.quantity == _OF_MAP[what]), None)
    return gap is not None and gap.before > _bound(gap, found)


_OF_MAP = {
    "depth error": "depth of inner pixels",
    "holes": "pixels lost",
    "outline of the mask": "outline of the mask",
    "outline of the depth": "outline of the depth",
    "pixels at edges": "pixels that fly at edges",
    "brightness of the picture": "brightness of frames",
}
"""What a map is of, to the gap."""


def _parameter(name: str, value: Any, spread: float | None) -> Parameter:
    unit = UNITS[name]
    if isinstance(value, tuple) or spread is None or not np.isfinite(spread):
        return Parameter(value, None, None, unit)
    return Parameter(float(value), float(value - NINETY * spread), float(value + NINETY * spread), unit)


# --- claims -----------------------------------------------------------------------------------------------------------


def _geometric(found: Found) -> list[_Claim]:
    """Every effect of the geometry, by what frames lose when it alone is taken out."""
    g, design, confirm = found.geometry, found.design, found.split[2]
    if not g.chosen:
        return []
    blocks = thinned(design.blocks, 9000)
    fitting, judging = [b.of(found.split[0]) for b in blocks], [b.of(confirm) for b in blocks]
    full = density(judging, g.fit, confirm)
    whole_gain = float((full - density(judging, g.null_fit, confirm)).mean())
    shared = set.intersection(*({_name(k) for k in keys} for keys in g.rivals))
    chosen = next(t for t in g.tried if t.names == tuple(e.key for e in g.chosen))
    claims = []
    for effect in g.chosen:
        others = [c for e in g.chosen if e is not effect for c in design.columns[e.key]]
        without = fitted(fitting, others)
        values, spreads = {}, {}
        for k, (field, column) in enumerate(zip(effect.parameters, design.columns[effect.key], strict=True)):
            at = g.fit.chosen.index(column)
            values[field] = float(effect.signs[k] * g.fit.beta[at])
            spreads[field] = float(np.sqrt(max(g.fit.covariance[at, at], 0.0)))
        gains = full - density(judging, without, confirm)
        refused = _given_way(found, effect, chosen)
        claims.append(_Claim(effect.name, gains, values, spreads, effect.name in shared, refused))
    return claims if whole_gain > 0 else []


def _name(key: str) -> str:
    return key.partition(",")[0]


def _given_way(found: Found, effect: Effect, chosen: Tried) -> str:
    """Why an effect gives way to a nameless rival that explains more: beside it, it gains nothing or has another size.

    What is really there keeps its size whatever else is in the model; what stood in for something else does not.
    """
    g = found.geometry
    best = max((alone for alone, _, _ in g.beside.values()), key=lambda t: t.mean)
    if best.mean - g.null.mean > TWICE * (chosen.mean - g.null.mean) and _closed(found) < HALF:
        return f"{PLAIN[effect.name]}: depth errors by {best.names[0]} explain far more than the whole set"
    columns = found.design.columns[effect.key]
    own = np.array([g.fit.beta[g.fit.chosen.index(c)] for c in columns])
    sizes = np.sqrt(np.mean(np.concatenate([b.columns[:, columns] ** 2 for b in found.design.blocks]), 0))
    for key, (alone, both, fit) in g.beside.items():
        more = alone.densities - chosen.densities
        spare = max(standard_error(more), LEAST_SHARE * (chosen.mean - g.null.mean))
        if more.mean() <= spare and both.mean - chosen.mean <= HALF * (chosen.mean - g.null.mean):
            continue
        beside = np.array([fit.beta[fit.chosen.index(c)] for c in columns])
        size = max(float(np.linalg.norm(own * sizes)), 1e-15)
        change = float(np.linalg.norm((beside - own) * sizes)) / size
        gain = both.densities - alone.densities
        if change > KEEPS or gain.mean() <= standard_error(gain):
            return f"{PLAIN[effect.name]}: depth errors by {key} explain more, and beside them it has another size"
    return ""


def _closed(found: Found) -> float:
    """Share of the gap in depth and outlines that the geometry closes on confirming frames: the most of the three."""
    before, after = _sizes(found, found.geometry.null_fit), _sizes(found, found.geometry.fit)
    return max(1 - a / b if b > 0 else 0.0 for a, b in zip(after, before, strict=True))


def _sizes(found: Found, fit: LinearFit) -> list[float]:
    return left(found.design.blocks, fit, found.split[2])


def _counted(found: Found) -> list[_Claim]:
    """Noise, holes and flying pixels."""
    claims = []
    for family in found.families:
        if not family.chosen:
            continue
        rival = max((t for t in family.tried if t.nameless), key=lambda t: t.mean, default=None)
        chosen = next(t for t in family.tried if t.names == family.chosen)
        refused = ""
        if (
            rival is not None
            and rival.mean - family.null.mean > TWICE * (chosen.mean - family.null.mean)
            and family.after > HALF * family.before
        ):
            refused = f"{family.kind} by {rival.names[0]} explain more than {listed([PLAIN[n] for n in family.chosen])}"
        for name in family.chosen:
            fields = _FIELDS[name]
            values = {k: v for k, v in family.values.items() if k in fields}
            spreads = {k: v for k, v in family.spreads.items() if k in fields and k != "noise_at"}
            certain = all(name in set_ for set_ in family.rivals)
            claims.append(_Claim(name, family.gains, values, spreads, certain, refused))
    return claims


_FIELDS: dict[str, tuple[str, ...]] = {
    "axial_noise": ("noise", "noise_at"),
    "noise_growth": ("noise_growth",),
    "noise_grazing": ("noise_grazing",),
    "holes": ("holes",),
    "dark_holes": ("dark_share", "dark_level"),
    "grazing_holes": ("grazing_share", "grazing_angle"),
    "flying_pixels": ("flying_share", "flying_reach"),
}


def _coloured(found: Found) -> list[_Claim]:
    """Drifts of exposure and tone."""
    drift = found.drift
    if drift is None or not drift.chosen or drift.null is None:
        return []
    refused = drift.refused
    if drift.after > drift.before:
        refused = "the brightness changes over the film, but not alike in frames that were not fitted"
    values = {"exposure_drift": {"exposure": drift.exposure}, "gamma_drift": {"gamma": drift.gamma}}
    return [
        _Claim(name, drift.gains, values[name], {}, all(name in s for s in drift.rivals), refused)
        for name in drift.chosen
    ]


# --- what is left -----------------------------------------------------------------------------------------------------


def _gaps(found: Found, names: Sequence[str]) -> list[FilmGap]:
    """Before and after on confirming frames; what is not named closes nothing."""
    noise, lost, flies = found.families
    geometric = any(e.name in names for e in found.geometry.chosen)
    before = _sizes(found, found.geometry.null_fit)
    after = _sizes(found, found.geometry.fit) if geometric else before
    own = noise.values.get("noise", 0.0) if "axial_noise" in names else 0.0
    floors = (float(np.hypot(found.design.blocks[0].least[0], own)), ROUNDED_PX, ROUNDED_PX)
    gaps = [
        FilmGap(what, unit, b, a, floor)
        for what, unit, b, a, floor in zip(
            ("depth of inner pixels", "outline of the mask", "outline of the depth"),
            ("m", "px", "px"),
            before,
            after,
            floors,
            strict=True,
        )
    ]
    for family, unit in ((noise, "m"), (lost, ""), (flies, "")):
        closed = bool(set(family.chosen) & set(names))
        what = {"noise": "noise of single pixels", "holes": "pixels lost", "flying pixels": "pixels that fly at edges"}
        gaps.append(
            FilmGap(what[family.kind], unit, family.before, family.after if closed else family.before, family.floor)
        )
    drift = found.drift
    if drift is not None and drift.null is not None:
        closed = bool(set(drift.chosen) & set(names))
        gaps.append(
            FilmGap("brightness of frames", "stops", drift.before, drift.after if closed else drift.before, drift.floor)
        )
    return gaps


def _left(found: Found, gaps: Sequence[FilmGap], names: Sequence[str]) -> list[str]:
    """What is above the floor without a name, a line each."""
    out = []
    g = found.geometry
    nameless = [t for t in g.tried if t.nameless]
    chosen = next(t for t in g.tried if not t.nameless and t.names == tuple(e.key for e in g.chosen))
    for gap in gaps:
        bound = _bound(gap, found)
        if gap.after <= max(bound, LEFT * gap.before):
            continue
        if gap.quantity == "outline of the depth" and set(names) & _FRAYING:
            continue  # what is lost or flies at the rim is missing from the outline, too
        size = f"{1e3 * gap.after:.2g} mm" if gap.unit == "m" else f"{gap.after:.2g} {gap.unit}".strip()
        if gap.unit == "" and gap.quantity != "":
            size = f"{100 * gap.after:.2g} %"
        how = ""
        if gap.quantity == "depth of inner pixels":
            best = max(nameless, key=lambda t: t.mean)
            tau, sigma = g.fit.tau[0], g.fit.sigma[0]
            if best.mean - chosen.mean > 0.01 * abs(chosen.mean) and best.mean > chosen.mean + 1:
                how = f", mostly by {best.names[-1]}"
            elif tau > sigma:
                how = ", that changes from frame to frame"
        out.append(f"{gap.quantity}: {size} {how}".strip().replace(" ,", ","))
    return out


_FRAYING = {"flying_pixels", "holes", "dark_holes", "grazing_holes"}


def _bound(gap: FilmGap, found: Found) -> float:
    """What a gap must exceed to be called left."""
    if gap.quantity == "depth of inner pixels":
        return max(TWICE * gap.floor, LEAST_DEPTH * float(np.median(found.rows["z"])))
    if gap.quantity in ("pixels lost", "pixels that fly at edges"):
        return gap.floor
    return (1.25 if gap.unit == "px" else TWICE) * gap.floor


def _rivals(found: Found, names: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """Sets that cannot be told apart, of the first kind that has any and was confirmed."""
    kinds = [tuple(tuple(dict.fromkeys(_name(k) for k in keys)) for keys in found.geometry.rivals)]
    kinds += [family.rivals for family in found.families]
    if found.drift is not None:
        kinds.append(found.drift.rivals)
    for sets in kinds:
        if len(sets) > 1 and set(sets[0]) & set(names):
            return sets
    return ()


def _cannot_tell(found: Found) -> tuple[tuple[str, str], ...]:
    out = []
    if found.scene.same_video:
        why = (
            "the asset was reconstructed from this camera's own video and has taken it on in its size and shape; "
            "an asset of known size (export --scale, or a CAD model) would tell"
        )
        out.append(("depth_scale, depth_offset, depth_curve, focal_length, principal_point", why))
        if found.drift is not None:
            out.append(("gamma_drift", "light that wanders over the asset's surface looks alike"))
    if "depth_delay" in found.shut:
        out.append(("depth_delay", "the object hardly moves in the picture: under half a pixel a frame"))
    if found.drift is None:
        out.append(("exposure_drift, gamma_drift", "the asset says nothing of its colours"))
    bright, angle = found.rows["measured_brightness"], np.degrees(np.arccos(np.clip(found.rows["cosine"], 0, 1)))
    if np.quantile(bright, 0.02) > 0.3:
        out.append(("dark_holes", f"no surface is darker than {100 * np.quantile(bright, 0.02):.0f} %"))
    if np.quantile(angle, 0.98) < 55:
        out.append(("grazing_holes", f"no surface is seen flatter than {np.quantile(angle, 0.98):.0f} degrees"))
    return tuple(out)


# --- words ------------------------------------------------------------------------------------------------------------


def _sentence(
    verdict: str,
    named: Sequence[Named],
    rivals: Sequence[Sequence[str]],
    found: Found,
    remains: Sequence[str],
    best: CameraFaults,
) -> str:
    lines = []
    sure = [told(n.name, best) for n in named if n.certain]
    if sure:
        lines.append(f"{_capital(listed(sure))}.")
    if rivals:
        lines.append(
            f"These frames cannot decide between {', or '.join(listed([PLAIN[n] for n in r]) for r in rivals)}."
        )
    if found.part is not None:
        size = " x ".join(f"{1e3 * v:.0f}" for v in found.part.size)
        lines.append(f"The asset lacks something of about {size} mm that moves with its {found.part.part} part.")
    if verdict == "no_gap":
        lines.append("The simulated film is like the measured one: nothing exceeds what the comparison can tell.")
    if verdict == "unexplained":
        lines.append("The films part, and nothing in the library explains it.")
    if remains:
        lines.append(f"Left: {'; '.join(remains)}.")
    return " ".join(lines)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _place(m: FilmMap) -> str:
    """A flagged map in words: its largest stretch."""
    factor = {"mm": 1e3, "%": 100.0}.get(m.unit, 1.0)
    if len(m.rows):
        at = np.unravel_index(int(np.nanargmax(np.where(m.flagged, np.abs(m.before), -1))), m.before.shape)
        u, v = (float(e[i] + e[i + 1]) / 2 for e, i in ((m.edges, at[1]), (m.rows, at[0])))
        return f"{m.what}: {factor * float(m.before[at]):+.2g} {m.unit} at {u:.0f}, {v:.0f} px from the principal point"
    k = int(np.nanargmax(np.where(m.flagged, np.abs(m.before), -1)))
    low, high = m.edges[k], m.edges[k + 1]
    size = f"{factor * float(m.before[k]):+.2g} {m.unit}"
    return f"{m.what}: {size} at {m.over} {low:.2g} to {high:.2g} {m.over_unit}".strip()
