"""Rows summed up: rates with Clopper and Pearson's 95 % bounds, and what went wrong, case by case."""

from __future__ import annotations

from collections import Counter

import numpy as np

from benchmarks.second_world.grade import RIGHT

GOALS = {  # issue 32: a second hidden world, scored once a release
    "clear singles right": ">= 90 %",
    "wrong names where the truth is outside": "<= 5 %",
    "false alarms on nulls": "<= 1 %",
    "pairs right": ">= 60 %",
    "pairs called by one wrong name": "0",
    "intervals that hold": ">= 85 %",
}


def rate(hits: int, of: int) -> dict:
    """A share with its exact 95 % bounds (Clopper and Pearson 1934)."""
    from scipy.stats import beta

    low = float(beta.ppf(0.025, hits, of - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, of - hits)) if hits < of else 1.0
    return {"hits": hits, "of": of, "low": low, "high": high}


def _of(rows: list[dict], test) -> dict:
    return rate(sum(bool(test(row)) for row in rows), len(rows))


def figures(rows: list[dict]) -> dict:
    """Every figure of the score, by its words."""
    by = {
        s: [r for r in rows if r["stratum"] == s]
        for s in ("null", "clear", "weak", "pair", "outside", "still", "gauge")
    }
    spans = [i for r in rows for i in r["intervals"]]
    out = {
        "clear singles right": _of(by["clear"], lambda r: r["outcome"] in RIGHT),
        "clear singles exact": _of(by["clear"], lambda r: r["outcome"] == "exact"),
        "clear singles right by family": _of(by["clear"], lambda r: r.get("family")),
        "clear singles open, truth among rivals": _of(by["clear"], lambda r: r["outcome"] == "open"),
        "wrong names where the truth is outside": _of(by["outside"], lambda r: r["outcome"] == "wrong"),
        "the same, rivals and overclaims counted": _of(
            by["outside"], lambda r: r["outcome"] in ("wrong", "wrong rivals", "overclaimed")
        ),
        "outside refused, or named in part rightly": _of(by["outside"], lambda r: r["outcome"] in ("right", "partly")),
        "false alarms on nulls": _of(by["null"], lambda r: r["outcome"] in ("wrong", "alarm")),
        "pairs right": _of(by["pair"], lambda r: r["outcome"] in RIGHT),
        "pairs: one of two": _of(by["pair"], lambda r: r["outcome"] == "partly"),
        "pairs called by one wrong name": _of(by["pair"], lambda r: r.get("one_wrong_name")),
        "weak singles right": _of(by["weak"], lambda r: r["outcome"] in RIGHT),
        "not excited, said so": _of(by["still"], lambda r: r["outcome"] == "right"),
        "not excited, named or alarmed": _of(by["still"], lambda r: r["outcome"] in ("wrong", "alarm")),
        "gauges told as such": _of(by["gauge"], lambda r: r["outcome"] == "right"),
        "gauges: one of the group alone": _of(by["gauge"], lambda r: r["outcome"] == "committed"),
        "intervals that hold": rate(sum(i["holds"] for i in spans), len(spans)),
        "repairs that widen a held-out gap": _of([r for r in rows if "hurt" in r], lambda r: r["hurt"]),
    }
    for stratum in ("clear", "weak", "pair", "still", "gauge"):
        out[f"wrong names, {stratum}"] = _of(by[stratum], lambda r: r["outcome"] == "wrong")
    return out


def medians(rows: list[dict]) -> dict:
    gone = [r["closed"] for r in rows if r["closed"] is not None]
    seconds = [r["seconds"] for r in rows]
    return {
        "held-out gap closed, median": float(np.median(gone)) if gone else None,
        "held-out gap closed, worst tenth": float(np.quantile(gone, 0.1)) if gone else None,
        "seconds a verdict, median": float(np.median(seconds)) if seconds else None,
        "seconds a verdict, most": max(seconds, default=None),
        "no answer": sum(r["outcome"] == "failed" for r in rows),
    }


def lines(rows: list[dict]) -> list[str]:
    """The printed score: bad rows first, then figures."""
    order = (
        "wrong",
        "failed",
        "wrong rivals",
        "overclaimed",
        "alarm",
        "committed",
        "missed",
        "refused",
        "open",
        "partly",
        "near",
    )
    bad = sorted((r for r in rows if r["outcome"] in order), key=lambda r: order.index(r["outcome"]))
    out = [f"{'outcome':13} {'stratum':8} {'machine':9} {'protocol':11} {'floors':>9}  truth -> said"]
    for r in bad:
        floors = "/".join(f"{f:.0f}" if f >= 10 else f"{f:.1f}" for f in r["floors"])
        truth = "+".join(r["truth"]) or "nothing"
        out.append(
            f"{r['outcome']:13} {r['stratum']:8} {r['kind']:9} {r['protocol']:11} {floors:>9}  {truth} -> {r['said']}"
            + (" (in part)" if r.get("in_part") else "")
        )
    out.append("")
    for words, f in figures(rows).items():
        if not f["of"]:
            continue
        share = f"{f['hits']} of {f['of']}"
        goal = GOALS.get(words, "")
        out.append(f"{words:45} {share:>11}  {100 * f['low']:3.0f} to {100 * f['high']:3.0f} %  {goal}".rstrip())
    out += [f"{words:45} {value if value is None else round(value, 2):>11}" for words, value in medians(rows).items()]
    return out


def confusions(rows: list[dict]) -> list[dict]:
    """Truth against answer, most frequent first; right ones left out."""
    seen = Counter(
        ("+".join(r["truth"]) or "nothing", r["said"]) for r in rows if r["outcome"] not in RIGHT | {"right"}
    )
    return [{"truth": truth, "said": said, "cases": n} for (truth, said), n in seen.most_common()]
