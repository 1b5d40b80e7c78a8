"""One verdict against one label: a word for the outcome, the wrong names in it, intervals. No case is graded by hand.
What is right by physics was written down before any case was asked.

Outcomes: `exact`; `by physics` (as good by `find_equals`, or rivals that all are); `partly` (some of a pair, nothing
wrong, or of an effect from outside what is truly there, said in part); `open` (rivals, the truth among them); `wrong`
(a name that is not there); `wrong rivals` (rivals without the truth); `overclaimed` (a part said to be the whole);
`refused` (unexplained); `missed` (no gap, or not excited); `failed` (no answer). Where nothing is to be named: `right`,
`near` (no gap where nothing moved), `alarm` (unexplained), `wrong`.
"""

from __future__ import annotations

from itertools import permutations

RIGHT = {"exact", "by physics"}
# Of effects outside the library: names that say a part of the truth. Said of the whole, they claim too much.
IN_PART: dict[str, set[str]] = {
    "cogging": set(),
    "belt_elasticity": set(),
    "temperature_drift": {"coulomb_friction"},  # it is dry friction, of a size that changes
    "cable_torque": {"return_spring"},  # it pulls back as a spring does, on one side and stiffening
    "magnet": {"detent"},  # it draws the part to a place, as a notch does, but from further off
    "asymmetric_friction": {"coulomb_friction"},  # it is dry friction, of two sizes
    "time_varying_damping": {"viscous_damping"},  # it is oil, of a size that changes
}


def find_equals(name: str, label: dict) -> set[str]:
    """Names as good as `name` on this case, never `name` itself: what no such data can tell apart."""
    groups = (
        # a load differs from dry friction only where the load does
        ({"coulomb_friction", "load_friction"}, label["steady_load"]),
        # a joint under gravity shows but the sum of encoder zero, lean and angle of the centre of mass
        ({"gravity_offset", "encoder_offset"}, label["kind"] != "drawer"),
        # late commands and late readings are one shift, where nothing else acts at a known time
        ({"actuator_delay", "time_offset"}, label["kind"] == "arm" and label["protocol"] == "usual"),
        # without gravity and without a known force only the ratio of drive and inertia is seen
        ({"actuator_gain", "armature"}, label["protocol"] == "asked"),
    )
    return set().union(*(group for group, holds in groups if holds and name in group)) - {name}


def _names(verdict: dict) -> set[str]:
    return {effect["name"] for effect in verdict["effects"]}


def _match(names: set[str], truth: list[str], label: dict) -> str | None:
    """`exact`, `by physics`, or None: the names, one for one."""
    if names == set(truth):
        return "exact"
    good = [{b} | find_equals(b, label) for b in truth]
    same = len(names) == len(truth) and any(
        all(a in b for a, b in zip(order, good, strict=True)) for order in permutations(names)
    )
    return "by physics" if same else None


def _grade(verdict: dict, truth: list[str], label: dict) -> tuple[str, set[str]]:
    """A word, and the wrong names."""
    answer, names, rivals, stratum = (
        verdict["verdict"],
        _names(verdict),
        [set(rival) for rival in verdict["rivals"]],
        label["stratum"],
    )
    outside, gauge = stratum == "outside", stratum == "gauge"
    if stratum in ("null", "still"):
        if answer in ("no_gap", "not_excited", "unexplained"):
            right = answer == ("no_gap" if stratum == "null" else "not_excited")
            return ("right" if right else "alarm" if answer == "unexplained" else "near"), set()
        if answer == "named" and names == set(truth):
            return "exact", set()
        return "wrong", (names if answer == "named" else set().union(*rivals)) - set(truth)
    if answer not in ("named", "ambiguous"):
        return ("missed" if answer != "unexplained" else "right" if outside else "refused"), set()
    if outside:
        dry = truth[0] in ("temperature_drift", "asymmetric_friction") and label["steady_load"]
        good, part = IN_PART[truth[0]] | ({"load_friction"} if dry else set()), bool(verdict.get("in_part"))
    else:
        good = set(label["group"]) if gauge else set(truth).union(*(find_equals(name, label) for name in truth))
    if answer == "ambiguous":
        if outside:
            return ("partly" if part and all(rival <= good for rival in rivals) else "wrong rivals"), set()
        if gauge:  # all of the group has to be given, and nothing else
            met = any(len(rival) == 1 and rival <= good for rival in rivals)
            return ("wrong rivals" if not met else "right" if set().union(*rivals) == good else "open"), set()
        matches = [_match(rival, truth, label) for rival in rivals]
        return ("by physics" if matches and all(matches) else "open" if any(matches) else "wrong rivals"), set()
    if names - good:
        return "wrong", names - good
    if outside:
        return ("partly" if part else "overclaimed"), set()
    if gauge:  # one of it alone is a guess that may be right
        return "committed", set()
    if len(names) > len(truth):
        return "wrong", names - set(truth)
    return _match(names, truth, label) or "partly", set()


def check_intervals(verdict: dict, label: dict) -> list[dict]:
    """Each hidden effect that is named and has a size of the same meaning: whether the 90 % interval holds it.
    Parameters are found by their unit, as docs/formats.md writes it. Without a known force only ratios to the inertia
    can be seen, so then the size at the asset's inertia counts, too."""
    out = []
    for effect in label["effects"]:
        found = next((e for e in verdict["effects"] if e["name"] == effect["name"]), None)
        if found is None or not effect["same_form"] or verdict["verdict"] != "named":
            continue
        same = [p for p in found["parameters"].values() if p["unit"] == effect["unit"]]
        if len(same) != 1 or same[0].get("low") is None:
            continue
        low, high, values = same[0]["low"], same[0]["high"], [effect["value"]]
        if effect["unit"].startswith("N") and not label["known_force"]:
            values.append(effect["value"] / label["inertia"])
        holds = any(low <= v <= high for v in values)
        out.append({"name": effect["name"], "true": effect["value"], "low": low, "high": high, "holds": holds})
    return out


def grade(label: dict, answer: dict) -> dict:
    """The row of a case."""
    truth, verdict = [effect["name"] for effect in label["effects"]], answer["verdict"]
    row: dict = {key: label[key] for key in ("stratum", "kind", "protocol", "floors")}
    row |= {"truth": truth, "seconds": answer["seconds"], "wrong": [], "intervals": []}
    if verdict is None:
        return row | {"outcome": "failed", "said": answer["error"][-200:]}
    outcome, wrong = _grade(verdict, truth, label)
    held_out = [gap for gap in verdict["gap"] if gap["held_out"] and gap["after"] is not None]
    names, alone = _names(verdict), verdict["verdict"] == "named"
    names_given = " | ".join("+".join(sorted(rival)) for rival in verdict["rivals"]) or "+".join(sorted(names))
    return row | {
        "outcome": outcome,
        "said": f"{verdict['verdict']} {names_given}".strip(),
        "in_part": bool(verdict.get("in_part")),
        "wrong": sorted(wrong),
        "one_wrong_name": len(truth) == 2 and alone and len(names) == 1 and bool(wrong),
        "intervals": check_intervals(verdict, label),
        "hurt": any(g["after"] > g["before"] + g["floor"] for g in held_out),
    }


# Words of a figure, its goal, its stratum, and the outcomes, or the key of a row, that it counts.
_FIGURES: tuple[tuple[str, str, str, set[str] | str], ...] = (
    ("clear singles right", ">= 90 %", "clear", RIGHT),
    ("clear singles exact", "", "clear", {"exact"}),
    ("clear singles open, truth among rivals", "", "clear", {"open"}),
    ("wrong names where the truth is outside", "<= 5 %", "outside", {"wrong"}),
    ("the same, rivals and overclaims counted", "", "outside", {"wrong", "wrong rivals", "overclaimed"}),
    ("outside refused, or named in part rightly", "", "outside", {"right", "partly"}),
    ("false alarms on nulls", "<= 1 %", "null", {"wrong", "alarm"}),
    ("pairs right", ">= 60 %", "pair", RIGHT),
    ("pairs: one of two", "", "pair", {"partly"}),
    ("pairs called by one wrong name", "0", "pair", "one_wrong_name"),
    ("weak singles right", "", "weak", RIGHT),
    ("not excited, said so", "", "still", {"right"}),
    ("not excited, named or alarmed", "", "still", {"wrong", "alarm"}),
    ("gauges named as such", "", "gauge", {"right"}),
    ("gauges: one of the group alone", "", "gauge", {"committed"}),
    *((f"wrong names, {stratum}", "", stratum, {"wrong"}) for stratum in ("clear", "weak", "pair", "still", "gauge")),
)
_BAD = ("wrong", "failed", "wrong rivals", "overclaimed", "alarm", "committed", "missed", "refused", "open", "partly")


def _rate(hits: list, goal: str = "") -> dict:
    """A share with its exact 95 % bounds (Clopper and Pearson 1934)."""
    from scipy.stats import beta

    k, n = sum(map(bool, hits)), len(hits)
    low = float(beta.ppf(0.025, k, n - k + 1)) if k else 0.0
    high = float(beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
    return {"hits": k, "of": n, "low": low, "high": high, "goal": goal}


def count_figures(rows: list[dict]) -> dict:
    """Every figure of the score, by its words."""
    out = {}
    for words, goal, stratum, what in _FIGURES:
        of = [r for r in rows if r["stratum"] == stratum]
        out[words] = _rate([r.get(what) if isinstance(what, str) else r["outcome"] in what for r in of], goal)
    out["intervals that hold"] = _rate([i["holds"] for r in rows for i in r["intervals"]], ">= 85 %")
    out["repairs that widen a held-out gap"] = _rate([r["hurt"] for r in rows if "hurt" in r])
    return out


def table_lines(rows: list[dict]) -> list[str]:
    """The printed score: bad rows first, then figures."""
    out = [f"{'outcome':13} {'stratum':8} {'machine':9} {'protocol':11} {'floors':>9}  truth -> said"]
    for r in sorted((r for r in rows if r["outcome"] in _BAD), key=lambda r: _BAD.index(r["outcome"])):
        floors = "/".join(f"{f:.0f}" if f >= 10 else f"{f:.1f}" for f in r["floors"])
        case = f"{r['outcome']:13} {r['stratum']:8} {r['kind']:9} {r['protocol']:11} {floors:>9}"
        part = " (in part)" * bool(r.get("in_part"))
        out.append(f"{case}  {'+'.join(r['truth']) or 'nothing'} -> {r['said']}{part}")
    for words, f in count_figures(rows).items():
        bounds = f"{100 * f['low']:3.0f} to {100 * f['high']:3.0f} %"
        out.append(f"{words:45} {f['hits']:4} of {f['of']:3}  {bounds}  {f['goal']}")
    return out
