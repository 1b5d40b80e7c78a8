"""Whether `gap` names what a camera does to a film: cameras with one fault each, of a size drawn at random.

The faults are those of `film_faults`, which share no code with what looks for them, put upon clean recordings:

    freeart21 record swivel_usb filing_cabinet --out data/film --seed 2611 --frames 60 --width 320 \\
        --height 180 --shader trivial
    python -m benchmarks.film_gap --data data/film --out benchmarks/results/film_gap.json

Weak faults may be below what is named at all: an object 8 cm away hardly shows what grows with the distance.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import film_faults as sensors
from benchmarks.common import RESULTS, run_cli, write_report
from freeart21.recording import Recording
from simgap.film.workflow import find_film_gap, read_film

Draw = Callable[[Recording, float, np.random.Generator], Recording]


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _way(rng: np.random.Generator) -> tuple[float, float]:
    a = rng.uniform(0, 2 * np.pi)
    return float(np.cos(a)), float(np.sin(a))


FAULTS: dict[str, tuple[str, tuple[float, float], tuple[float, float], Draw]] = {
    "reads long": ("depth_scale", (0.002, 0.006), (0.008, 0.04), lambda f, s, r: sensors.reads_long(f, s * _sign(r))),
    "reads off": ("depth_offset", (1e-3, 3e-3), (4e-3, 0.02), lambda f, s, r: sensors.reads_off(f, s * _sign(r))),
    "bends": ("depth_curve", (3e-3, 9e-3), (0.015, 0.06), lambda f, s, r: sensors.bends(f, s * _sign(r))),
    "rustles": ("axial_noise", (4e-4, 1e-3), (2e-3, 0.015), lambda f, s, r: sensors.rustles(f, s, r.uniform(1, 2))),
    "blind to dark": ("dark_holes", (0.08, 0.15), (0.2, 0.35), lambda f, s, r: sensors.blind_to_dark(f, s)),
    "blind to slopes": ("grazing_holes", (70, 76), (50, 66), lambda f, s, r: sensors.blind_to_slopes(f, s)),
    "frays": ("flying_pixels", (0.1, 0.2), (0.3, 0.7), lambda f, s, r: sensors.frays(f, s, int(r.integers(1, 4)))),
    "slips": (
        "misregistration",
        (0.6, 1.2),
        (2.0, 5.0),
        lambda f, s, r: sensors.slips(f, *(s * w for w in _way(r)), r.uniform(-1, 1)),
    ),
    "focal": ("focal_length", (4e-3, 0.01), (0.015, 0.05), lambda f, s, r: sensors.scale_focal(f, s * _sign(r))),
    "centre": (
        "principal_point",
        (0.4, 0.9),
        (1.5, 6.0),
        lambda f, s, r: sensors.shift_centre(f, *(s * w for w in _way(r))),
    ),
    "lags": ("depth_delay", (1, 1.01), (2, 3.99), lambda f, s, r: sensors.lags(f, int(s))),
    "brightens": ("exposure_drift", (0.2, 0.4), (0.6, 1.5), lambda f, s, r: sensors.brightens(f, s)),
    "steepens": ("gamma_drift", (0.05, 0.1), (0.15, 0.3), lambda f, s, r: sensors.steepens(f, s)),
}
"""Fault: its name in the library, ranges of weak and clear sizes, and how it is drawn."""
OUTSIDE: dict[str, Draw] = {
    "rolling vignette": lambda f, s, r: sensors.rolling_vignette(f, 0.3 + 0.4 * s),
    "second bounce": lambda f, s, r: sensors.second_bounce(f, 0.003 + 0.006 * s),
    "breathes": lambda f, s, r: sensors.breathes(f, 0.002 + 0.003 * s),
}
PAIRS = (("reads long", "rustles"), ("slips", "blind to dark"), ("lags", "frays"), ("focal", "brightens"))
_SUB = {"noise_growth", "noise_grazing"}
"""Ways of the noise: they go with it."""


def grade(truth: set[str], verdict: Any) -> str:
    """right, right among rivals, in part, silent or wrong."""
    named = {n.effect.name for n in verdict.effects} - _SUB
    rivals = [set(r) - _SUB for r in verdict.rivals]
    if named == truth:
        return "right"
    if named - truth and rivals and any(truth & r for r in rivals) and not (named - set().union(*rivals) - truth):
        return "right among rivals"
    if named - truth:
        return "wrong"
    return "in part" if named else "silent" if truth else "right"


def main(data: Path, objects: tuple[str, ...] = (), seed: int = 1, out: Path = RESULTS / "film_gap.json") -> None:
    """Film, ask and grade; the file is written after every case.

    Args:
        data: The data folder.
        objects: Sequences; the first three when none are named.
        seed: Of the sizes.
        out: The JSON file.
    """
    rows: list[dict[str, Any]] = []
    names = objects or tuple(path.name for path in sorted((data / "sequences").iterdir()))[:3]
    for o, name in enumerate(names):
        truth = data / "truth" / name
        film = read_film(truth / "object", data / "sequences" / name)
        clean = sensors.film_of(film.recording)
        for kind, made, expected, size in _cases(clean, np.random.default_rng([seed, o])):
            began = time.perf_counter()
            verdict, _ = find_film_gap(replace(film, recording=made))
            row = {
                "object": name,
                "case": kind,
                "size": size,
                "truth": sorted(expected),
                "named": [n.effect.name for n in verdict.effects],
                "rivals": [list(r) for r in verdict.rivals],
                "verdict": verdict.verdict,
                "grade": grade(expected, verdict),
                "seconds": round(time.perf_counter() - began, 1),
                "values": {k: v for n in verdict.effects for k, v in vars(n.effect).items()},
            }
            rows.append(row)
            print(f"{name:24} {kind:32} {size:8.3g} {row['grade']:20} {', '.join(row['named'])}", flush=True)
            write_report(out, {"seed": seed, "objects": names}, summary=_summary(rows), rows=rows)


def _shows(clean: Recording, made: Recording) -> bool:
    """Whether a fault of holes takes a hundredth of the object's pixels: else nothing is dark, or nothing steep."""
    before = after = 0
    for i in range(0, len(clean), 5):
        before += int((clean.frame(i).depth > 0).sum())
        after += int((made.frame(i).depth > 0).sum())
    return after < 0.99 * before


def _cases(clean: Recording, rng: np.random.Generator) -> list[tuple[str, Recording, set[str], float]]:
    cases: list[tuple[str, Recording, set[str], float]] = [("nothing", clean, set(), 0.0)]
    for strength in (0, 1):
        for fault, (name, weak, clear, draw) in FAULTS.items():
            size = float(rng.uniform(*(weak, clear)[strength]))
            made = draw(clean, size, rng)
            expected = {name} if not name.endswith("_holes") or _shows(clean, made) else set()
            cases.append((f"{fault}, {('weak', 'clear')[strength]}", made, expected, size))
    for first, second in PAIRS:
        made, size, expected = clean, 0.0, set[str]()
        for fault in (first, second):
            name, _, clear, draw = FAULTS[fault]
            size = float(rng.uniform(*clear))
            before, made = made, draw(made, size, rng)
            expected |= {name} if not name.endswith("_holes") or _shows(before, made) else set()
        cases.append((f"pair: {first} + {second}", made, expected, size))
    for fault, outside in OUTSIDE.items():
        size = float(rng.uniform())
        cases.append((f"outside: {fault}", outside(clean, size, rng), set(), size))
    return cases


def _summary(rows: list[dict[str, Any]]) -> dict[str, dict[str, int]]:
    kinds = {
        "nothing": [r for r in rows if r["case"] == "nothing"],
        "outside": [r for r in rows if r["case"].startswith("outside")],
        "weak": [r for r in rows if r["case"].endswith("weak")],
        "clear": [r for r in rows if r["case"].endswith("clear")],
        "pairs": [r for r in rows if r["case"].startswith("pair")],
    }
    grades = ("wrong", "silent", "in part", "right among rivals", "right")
    return {k: {g: sum(r["grade"] == g for r in rs) for g in grades} for k, rs in kinds.items()}


if __name__ == "__main__":
    run_cli(main)
