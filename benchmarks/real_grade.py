"""What an answer of `gap` on a real recording is worth: pure functions from known facts and an answer to a grade.

Nobody knows all that a real machine does, so an answer is graded by physics: by the effects that are known to dominate
and the sizes that are known of them (`real_expected.json`, whose terms these are).

    right      every dominant effect is named, nothing else that is not there, sizes within what is known of them
    in part    a dominant effect is named and none that is known not to be there; others, or sizes, are off, or a doubt
               is left in which every rival has a dominant effect, or the answer claims more than it does
    silent     nothing is named: unexplained, not excited, a doubt among others, no answer in time, refused
    wrong      what is not there is named, or nothing that dominates; nothing is reported missing where something is

Where the right answer is that nothing of the library explains it, that or silence is right and any name is wrong.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

GRADES = ("right", "in part", "silent", "wrong")
CLAIMED, LEFT = 0.9, 10.0
"""A plain name (not one in part) that closes so much of the gap, and leaves so many floors, claims too much."""


def grade_answer(
    known: dict[str, Any], groups: dict[str, list[str]], answer: dict[str, Any] | None
) -> tuple[str, list[str]]:
    """Grade and reasons of an answer, as `verdict.json` has it; None is no answer."""
    if answer is None:
        return "silent", ["no answer"]
    kind = "named_in_part" if answer["verdict"] == "named" and answer.get("in_part") else answer["verdict"]
    if known["answer"] == "unexplained":
        return ("right", []) if kind in ("unexplained", "not_excited") else ("wrong", [f"{kind}, expected unexplained"])
    if kind == "no_gap":
        return "wrong", ["says that nothing is missing"]
    if kind not in ("named", "named_in_part", "ambiguous"):
        return "silent", [kind]
    dominant = [set(groups.get(name, [name])) for name in known["dominant"]]
    if kind == "ambiguous":
        return _grade_rivals(known, groups, dominant, answer)
    names = {effect["name"] for effect in answer["effects"]}
    grade, reasons = _grade_names(known, groups, dominant, names)
    off, alien = _find_wrong_sizes(known, dominant, answer["effects"])
    reasons += off + alien
    if alien:
        return "wrong", reasons
    if grade == "right" and (off or overclaims(answer)):
        grade = "in part"
    if overclaims(answer):
        reasons.append("claims more than it does")
    return grade, reasons


def _grade_names(
    known: dict[str, Any], groups: dict[str, list[str]], dominant: list[set[str]], names: set[str]
) -> tuple[str, list[str]]:
    """Grade of a set of names, sizes apart."""
    also = {n for name in known["also"] for n in groups.get(name, [name])}
    hit = [bool(group & names) for group in dominant]
    absent = [f"{n} is not there: {known['never'][n]}" for n in sorted(names & set(known["never"]))]
    unknown = sorted(names - set().union(also, *dominant) - set(known["never"]))
    reasons = absent + [f"{n} is not known to be there" for n in unknown]
    reasons += [f"{known['dominant'][i]} is not named" for i, found in enumerate(hit) if not found]
    if absent or not any(hit):
        return "wrong", reasons
    return ("right" if all(hit) and not unknown else "in part"), reasons


def _grade_rivals(
    known: dict[str, Any], groups: dict[str, list[str]], dominant: list[set[str]], answer: dict[str, Any]
) -> tuple[str, list[str]]:
    """A doubt is right when all its rivals are, as those that are one thing by several names; else it is in part so
    when each has a dominant effect and nothing that is not there."""
    grades = [_grade_names(known, groups, dominant, set(names)) for names in answer["rivals"]]
    found = {grade for grade, _ in grades}
    reasons = list(dict.fromkeys(reason for _, why in grades for reason in why))
    if found == {"right"}:
        return "right", []
    if "wrong" not in found and found:
        return "in part", reasons
    return ("wrong" if found == {"wrong"} else "silent"), reasons


def _find_wrong_sizes(
    known: dict[str, Any], dominant: list[set[str]], effects: Iterable[dict[str, Any]]
) -> tuple[list[str], ...]:
    """Sizes that are off, of effects that dominate and of others: of these one that is off is another effect."""
    off: tuple[list[str], list[str]] = ([], [])
    for effect in effects:
        for name, entry in effect["parameters"].items():
            low, high = known["sizes"].get(f"{effect['name']}.{name}", (-np.inf, np.inf))
            if not low <= entry["value"] <= high:
                dominates = any(effect["name"] in group for group in dominant)
                off[not dominates].append(
                    f"{effect['name']} {name} {entry['value']:.3g}, known to be {low:.3g} to {high:.3g}"
                )
    return off


def measure_closing(answer: dict[str, Any] | None) -> dict[str, float | int | None]:
    """Of the runs that were neither fitted nor used to choose, where an answer tells them apart, else of those held
    out: floors before and after (root mean squares over runs), and the closed share of the gap beyond one floor."""
    rows = [] if answer is None else answer["gap"]
    confirming = [row for row in rows if row.get("use") == "confirming"]
    rows = confirming or [row for row in rows if row["held_out"]]
    if not rows:
        return {"runs": 0, "before": None, "after": None, "share": None}
    before, after = (
        float(np.sqrt(np.mean([(row[key] / row["floor"]) ** 2 for row in rows]))) for key in ("before", "after")
    )
    share = (before - after) / (before - 1) if before > 1 else None
    return {"runs": len(rows), "before": before, "after": after, "share": share}


def overclaims(answer: dict[str, Any]) -> bool:
    """Whether an answer names what is missing, nearly all of it, while many floors of the gap are left."""
    done = measure_closing(answer)
    if answer["verdict"] != "named" or answer.get("in_part") or done["share"] is None or done["after"] is None:
        return False
    return done["share"] >= CLAIMED and done["after"] > LEFT


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts of grades, of claims that are too large and of answers that did not come; medians."""
    count = {grade: sum(row["grade"] == grade for row in rows) for grade in GRADES}
    seconds = sorted(row["seconds"] for row in rows)
    named = [row for row in rows if row["verdict"] in ("named", "named_in_part") and row["closed"]["share"] is not None]
    good = count["right"] + count["in part"]
    return {
        "recordings": len(rows),
        **count,
        "right or in part, share": good / len(rows) if rows else None,
        "too large claims": sum(bool(row["overclaims"]) for row in rows),
        "no answer in time": sum(row["status"] == "out of time" for row in rows),
        "refused": sum(row["status"] == "refused" for row in rows),
        "median share closed where named": float(np.median([r["closed"]["share"] for r in named])) if named else None,
        "median seconds": float(np.median(seconds)) if seconds else None,
        "most seconds": seconds[-1] if seconds else None,
    }
