"""One verdict against one label: a word for the outcome, the wrong names in it, intervals, gap closed. No case is
graded by hand.

Outcomes: `exact`; `by physics` (a twin of it, or rivals that are all twins); `partly` (some of a pair, nothing wrong,
or of an effect from outside what is truly there, said in part); `open` (rivals, the truth among them); `wrong` (a name
that is not there); `wrong rivals` (rivals without the truth); `overclaimed` (a part said to be the whole); `refused`
(unexplained); `missed` (no gap, or not excited); `failed` (no answer). Where nothing is to be named: `right`, `near`
(no gap where nothing moved), `alarm` (unexplained), `wrong`.
"""

from __future__ import annotations

import re
from itertools import permutations

from benchmarks.second_world.physics_says import FAMILIES, equals, part_of
from benchmarks.second_world.strata import OUTSIDE

RIGHT = {"exact", "by physics"}


def _names(verdict: dict) -> set[str]:
    return {effect["name"] for effect in verdict["effects"]}


def _rivals(verdict: dict) -> list[set[str]]:
    return [set(rival) for rival in verdict["rivals"]]


def _matches(said: set[str], truth: list[str], label: dict) -> str | None:
    """`exact`, `by physics`, or None: the names said, one for one."""
    if said == set(truth):
        return "exact"
    if len(said) == len(truth):
        for order in permutations(said):
            if all(a == b or a in equals(b, label) for a, b in zip(order, truth, strict=True)):
                return "by physics"
    return None


def _strange(said: set[str], truth: list[str], label: dict) -> set[str]:
    """Names said that are neither hidden nor as good as what is."""
    good = set(truth).union(*(equals(name, label) for name in truth))
    return said - good


def _of_library(verdict: dict, truth: list[str], label: dict) -> tuple[str, set[str]]:
    said = _names(verdict)
    match verdict["verdict"]:
        case "named":
            strange = _strange(said, truth, label)
            if strange or len(said) > len(truth):
                return "wrong", strange or said - set(truth)
            return _matches(said, truth, label) or "partly", set()
        case "ambiguous":
            rivals = _rivals(verdict)
            met = [_matches(rival, truth, label) for rival in rivals]
            if rivals and all(met):
                return "by physics", set()
            return ("open" if any(met) else "wrong rivals"), set()
        case "unexplained":
            return "refused", set()
    return "missed", set()


def _of_outside(verdict: dict, truth: list[str], label: dict) -> tuple[str, set[str]]:
    allowed, part = part_of(truth[0], label), bool(verdict.get("in_part"))
    match verdict["verdict"]:
        case "named":
            strange = _names(verdict) - allowed
            return ("wrong", strange) if strange else ("partly" if part else "overclaimed", set())
        case "ambiguous":
            inside = all(rival <= allowed for rival in _rivals(verdict))
            return ("partly" if inside and part else "wrong rivals"), set()
        case "unexplained":
            return "right", set()
    return "missed", set()


def _of_gauge(verdict: dict, label: dict) -> tuple[str, set[str]]:
    """All of the group has to be told, and nothing else; one of it alone is a guess that may be right."""
    group = set(label["group"])
    match verdict["verdict"]:
        case "ambiguous":
            rivals = _rivals(verdict)
            if any(rival == {name} for rival in rivals for name in group):
                return (
                    "right" if all(rival <= group for rival in rivals) and group <= set().union(*rivals) else "open"
                ), set()
            return "wrong rivals", set()
        case "named":
            strange = _names(verdict) - group
            return ("wrong", strange) if strange else ("committed", set())
        case "unexplained":
            return "refused", set()
    return "missed", set()


def _of_nothing(verdict: dict, right: str, truth: list[str]) -> tuple[str, set[str]]:
    said = verdict["verdict"]
    if said == right:
        return "right", set()
    if said in ("no_gap", "not_excited"):
        return "near", set()
    if said == "named" and _names(verdict) == set(truth):
        return "exact", set()
    if said == "unexplained":
        return "alarm", set()
    return "wrong", (_names(verdict) if said == "named" else set().union(*_rivals(verdict))) - set(truth)


def _unit(text: str) -> dict[str, int]:
    """Powers of a unit's parts, radians left out: N*m*s/rad is N m s; an angle alone and a plain number stay what they
    are."""
    if text in ("rad", "1"):
        return {text: 1}
    powers: dict[str, int] = {}
    sign = 1
    for token in re.findall(r"[*/]|[A-Za-z]+(?:\^?\d+)?", text.replace("**", "^")):
        if token in "*/":
            sign = 1 if token == "*" and sign == 1 else -1
            continue
        name, power = re.fullmatch(r"([A-Za-z]+)\^?(\d*)", token).groups()  # type: ignore[union-attr]
        if name != "rad":
            powers[name] = powers.get(name, 0) + sign * int(power or 1)
    return {name: power for name, power in powers.items() if power}


def intervals(verdict: dict, label: dict) -> list[dict]:
    """Each hidden effect that is named and has a size of the same meaning: whether the 90 % interval holds it.
    Parameters are found by their unit. Without a known force only ratios to the inertia can be seen, so then the size
    at the asset's inertia counts, too."""
    out = []
    for effect in label["effects"]:
        said = next((e for e in verdict["effects"] if e["name"] == effect["name"]), None)
        if said is None or not effect["same_form"] or verdict["verdict"] != "named":
            continue
        same = [p for p in said["parameters"].values() if _unit(p["unit"]) == _unit(effect["unit"])]
        if len(same) != 1 or same[0].get("low") is None:
            continue
        low, high = same[0]["low"], same[0]["high"]
        force = "N" in _unit(effect["unit"])
        values = [effect["value"]] + (
            [effect["value"] / label["inertia"]] if force and not label["known_force"] else []
        )
        out.append(
            {
                "name": effect["name"],
                "true": effect["value"],
                "low": low,
                "high": high,
                "holds": any(low <= v <= high for v in values),
            }
        )
    return out


def closed(verdict: dict) -> float | None:
    """Share of the gap above the floor that is gone on held-out runs; None where there was none to speak of (twice the
    floor)."""
    rows = [row for row in verdict["gap"] if row["held_out"]]
    before, after, floor = (sum(row[key] for row in rows) for key in ("before", "after", "floor"))
    return (before - after) / (before - floor) if rows and before > 2 * floor else None


def grade(label: dict, answer: dict) -> dict:
    """The row of a case."""
    truth, stratum = [effect["name"] for effect in label["effects"]], label["stratum"]
    row: dict = {
        "stratum": stratum,
        "kind": label["kind"],
        "protocol": label["protocol"],
        "truth": truth,
        "floors": label["floors"],
    }
    row["seconds"], verdict = answer["seconds"], answer["verdict"]
    if verdict is None:
        return {
            **row,
            "outcome": "failed",
            "said": answer["error"][-200:],
            "wrong": [],
            "intervals": [],
            "closed": None,
        }
    if stratum == "null":
        outcome, wrong = _of_nothing(verdict, "no_gap", [])
    elif stratum == "still":
        outcome, wrong = _of_nothing(verdict, "not_excited", truth)
    elif stratum == "gauge":
        outcome, wrong = _of_gauge(verdict, label)
    elif truth[0] in OUTSIDE:
        outcome, wrong = _of_outside(verdict, truth, label)
    else:
        outcome, wrong = _of_library(verdict, truth, label)
    said = " | ".join("+".join(sorted(rival)) for rival in _rivals(verdict)) or "+".join(sorted(_names(verdict)))
    row |= {
        "outcome": outcome,
        "said": f"{verdict['verdict']} {said}".strip(),
        "in_part": bool(verdict.get("in_part")),
        "wrong": sorted(wrong),
    }
    families = {FAMILIES.get(name, name) for name in truth}
    row["family"] = outcome in RIGHT or (
        verdict["verdict"] == "named" and {FAMILIES.get(n, n) for n in _names(verdict)} == families
    )
    row["one_wrong_name"] = bool(
        len(truth) == 2 and verdict["verdict"] == "named" and len(_names(verdict)) == 1 and wrong
    )
    hurt = any(g["held_out"] and g["after"] > g["before"] + g["floor"] for g in verdict["gap"])
    return {
        **row,
        "intervals": intervals(verdict, label),
        "closed": closed(verdict) if verdict["verdict"] == "named" else None,
        "hurt": hurt,
    }
