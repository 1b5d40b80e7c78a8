"""What verdicts on sealed cases are worth: pure functions from labels and verdicts to numbers."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

SAME, OTHER = (8, 9, 10), (11, 12)
"""Held-out runs of every hidden case: of the fitted regime, and of a wilder one."""
VISIBLE = 2.5
"""Floors beyond plainer effects below which a strange effect is none."""


def clopper_pearson(k: int, n: int, level: float = 0.95) -> tuple[float, float]:
    """Exact two-sided interval of a share."""
    if n == 0:
        return 0.0, 1.0
    found = stats.binomtest(k, n).proportion_ci(level, "exact")
    return float(found.low), float(found.high)


def upper(k: int, n: int, level: float = 0.95) -> float:
    """Exact one-sided upper bound of a share."""
    return 1.0 if k >= n else float(stats.beta.ppf(level, k + 1, n - k))


def wilson(k: int, n: int, level: float = 0.95) -> tuple[float, float]:
    """Wilson's interval of a share."""
    if n == 0:
        return 0.0, 1.0
    found = stats.binomtest(k, n).proportion_ci(level, "wilson")
    return float(found.low), float(found.high)


def share(rows: list[dict[str, Any]], key: str = "right") -> dict[str, Any]:
    """k of n, share and Wilson's interval of the rows in which `key` is true."""
    k, n = sum(bool(row[key]) for row in rows), len(rows)
    low, high = wilson(k, n)
    return {"k": k, "n": n, "share": k / n if n else None, "wilson95": [low, high]}


def names_of(verdict: dict[str, Any]) -> tuple[str, ...]:
    """The effects that a verdict names."""
    return tuple(sorted(e["name"] for e in verdict.get("effects") or []))


def sets_of(verdict: dict[str, Any]) -> set[tuple[str, ...]]:
    """All sets that an ambiguous verdict cannot tell apart."""
    return {tuple(sorted(s)) for s in verdict.get("rivals") or []} | {names_of(verdict)}


def judged(label: dict[str, Any], verdict: dict[str, Any], seconds: dict[str, float]) -> dict[str, Any]:
    """One row: what was hidden, what was said, whether it is right, and how much of the gap is closed."""
    truth = tuple(sorted(e["name"] for e in label["effects"]))
    said, kind = names_of(verdict), verdict["verdict"]
    row: dict[str, Any] = {
        "id": label["id"], "stratum": label["stratum"], "strength": label["strength"], "rig": label["rig"],
        "kind": label["kind"], "family": label["family"], "truth": truth, "verdict": kind, "said": said,
        "ratio": label["ratio"], "distinct": label["distinct"], "size": [e["size"] for e in label["effects"]],
        "seconds": seconds["verdict"],
    }  # fmt: skip
    gauge = {(name,) for name in label["sets"]}
    row["right"] = {
        "null": kind == "no_gap",
        "strange": kind not in ("named", "crashed"),
        "gauge": kind == "ambiguous" and truth in sets_of(verdict) and len(sets_of(verdict) & gauge) > 1,
        "still": kind == "not_excited",
    }.get(label["stratum"], kind == "named" and said == truth)
    row["held"] = kind == "ambiguous" and truth in sets_of(verdict)
    row["false_name"] = kind == "named" and bool(set(said) - set(truth))
    for regime, runs in (("same", SAME), ("other", OTHER)):
        row[f"closed_{regime}"], row[f"hurt_{regime}"] = closed(verdict, runs)
    row["covered"] = covered(label, verdict)
    return row


def closed(verdict: dict[str, Any], runs: tuple[int, ...]) -> tuple[float | None, bool]:
    """Part of the gap beyond the floor that is closed on these runs, and whether what was written widens it."""
    wanted = {f"run_{i:02d}" for i in runs}
    here = [g for g in verdict.get("gap") or [] if g["run"] in wanted and g.get("after") is not None]
    if not here:
        return None, False
    before, after, floor = (np.sqrt(np.mean([g[k] ** 2 for g in here])) for k in ("before", "after", "floor"))
    hurt = bool(verdict.get("added")) and bool(after > before + 0.25 * floor)
    return (float((before - after) / (before - floor)) if before > 1.5 * floor else None), hurt


def covered(label: dict[str, Any], verdict: dict[str, Any]) -> list[bool]:
    """Whether each parameter that means the same here and there lies in its interval; of effects named rightly."""
    found = []
    said = {e["name"]: e["parameters"] for e in verdict.get("effects") or []} if verdict["verdict"] == "named" else {}
    for effect in label["effects"]:
        for name, value in effect["parameters"].items():
            given = said.get(effect["name"], {}).get(name)
            if given is not None and given.get("low") is not None:
                found.append(bool(given["low"] <= value <= given["high"]))
    return found


def confusion(rows: list[dict[str, Any]]) -> tuple[list[str], list[str], np.ndarray]:
    """Truths, answers and counts of nulls, clear singles, and of what no library has."""
    table: Counter[tuple[str, str]] = Counter()
    for row in rows:
        if row["stratum"] in ("single", "kinematic", "null", "strange") and row["strength"] == "clear":
            truth = row["truth"][0] if row["truth"] else "nothing"
            said = "+".join(row["said"]) if row["verdict"] == "named" else row["verdict"]
            table[truth, said if row["verdict"] != "named" or len(row["said"]) == 1 else "two or more"] += 1
    truths = sorted({t for t, _ in table})
    answers = sorted({s for _, s in table}, key=lambda s: (s not in truths, s))
    counts = np.array([[table[t, s] for s in answers] for t in truths]).reshape(len(truths), len(answers))
    return truths, answers, counts


def smallest_nameable(rows: list[dict[str, Any]]) -> dict[str, dict[str, float | None]]:
    """Effect to the smallest gap (floors) and size from which on four of five cases or more are named rightly."""
    found: dict[str, dict[str, float | None]] = {}
    singles = [r for r in rows if r["stratum"] == "single"]
    for name in sorted({r["truth"][0] for r in singles}):
        own = sorted((r for r in singles if r["truth"] == (name,)), key=lambda r: r["ratio"])
        right = np.array([r["right"] for r in own], float)
        tail = np.cumsum(right[::-1])[::-1] / np.arange(len(right), 0, -1)
        good = [i for i in range(len(own)) if tail[i] >= 0.8 and right[i]]
        found[name] = {
            "floors": own[good[0]]["ratio"] if good else None,
            "size": own[good[0]]["size"][0] if good else None,
            "cases": float(len(own)),
        }
    return found


def picture(rows: list[dict[str, Any]], path: Path) -> None:
    """The confusion matrix, drawn: truths down, answers across, shares in grey and counts in figures."""
    from PIL import Image, ImageDraw

    truths, answers, counts = confusion(rows)
    cell, left, top = 26, 170, 150
    image = Image.new("RGB", (left + cell * len(answers) + 10, top + cell * len(truths) + 10), "white")
    draw = ImageDraw.Draw(image)
    for i, truth in enumerate(truths):
        draw.text((8, top + i * cell + 7), truth, fill="black")
        for j, said in enumerate(answers):
            part = counts[i, j] / max(counts[i].sum(), 1)
            at = (left + j * cell, top + i * cell)
            right = truth == said or (truth == "nothing" and said == "no_gap")
            shade = int(255 * (1 - part))
            fill = (shade, 255 if right else shade, shade) if part else (255, 255, 255)
            draw.rectangle((*at, at[0] + cell, at[1] + cell), fill=fill, outline=(210, 210, 210))
            if counts[i, j]:
                draw.text(
                    (at[0] + 6, at[1] + 7), str(counts[i, j]), fill="white" if shade < 128 and not right else "black"
                )
    for j, said in enumerate(answers):
        label = Image.new("RGBA", (top - 10, 14))
        ImageDraw.Draw(label).text((0, 0), said, fill="black")
        turned = label.rotate(90, expand=True)
        image.paste(turned, (left + j * cell + 6, top - turned.height - 4), turned)
    path.parent.mkdir(parents=True, exist_ok=True)
    image.save(path)


def _median(values: list[float | None]) -> float | None:
    real = [v for v in values if v is not None and np.isfinite(v)]
    return float(np.median(real)) if real else None


def summary(rows: list[dict[str, Any]], alone: list[dict[str, Any]]) -> dict[str, Any]:
    """The figures of the issue, each with its counts; `alone` are the answers with the truth out of the library."""
    by = {s: [r for r in rows if r["stratum"] == s] for s in {r["stratum"] for r in rows}}
    nulls = by.get("null", [])
    false = sum(r["verdict"] != "no_gap" for r in nulls)
    singles = by.get("single", []) + by.get("kinematic", [])
    clear = [r for r in singles if r["strength"] == "clear"]
    weak = [r for r in singles if r["strength"] == "weak"]
    strange = [r for r in by.get("strange", []) if r["strength"] == "clear" and r["distinct"] >= VISIBLE]
    pairs = [r for r in by.get("pair", []) if r["strength"] == "clear"]
    real = [r for r in clear + pairs if r["truth"]]
    parameters = [c for r in real if r["right"] for c in r["covered"]]

    def part(rows: list[dict[str, Any]], key: str = "right") -> float | None:
        return share(rows, key)["share"]

    low, high = clopper_pearson(false, len(nulls))
    return {
        "nulls": len(nulls),
        "false_alarms": false,
        "false_alarm_upper95": upper(false, len(nulls)) if nulls else None,
        "false_alarm_clopper_pearson95": [low, high],
        "false_names_on_nulls": sum(r["verdict"] == "named" for r in nulls),
        "clear_singles_top1": part(clear),
        "weak_singles_top1": part(weak),
        "out_of_library_false_names": part(strange, "false_name"),
        "leave_one_out_refused": part(alone, "refused"),
        "pairs_exact": part(pairs),
        "ambiguous_answered": part(by.get("gauge", [])),
        "not_excited_answered": part(by.get("still", [])),
        "closed_fraction_median": _median([_closed(r, "same") for r in real]),
        "closed_fraction_other_regime_median": _median([_closed(r, "other") for r in real]),
        "repairs_that_hurt": sum(r["hurt_same"] or r["hurt_other"] for r in rows),
        "seconds_per_verdict_median": _median([r["seconds"] for r in rows]),
        "crashes": sum(r["verdict"] == "crashed" for r in rows),
        "interval_coverage": {"k": sum(parameters), "n": len(parameters), "nominal": 0.9},
        "intervals": {
            "clear_singles_top1": share(clear),
            "clear_singles_named_or_in_set": share([{**r, "ok": r["right"] or r["held"]} for r in clear], "ok"),
            "weak_singles_top1": share(weak),
            "weak_singles_false_names": share(weak, "false_name"),
            "pairs_exact": share(pairs),
            "out_of_library_false_names": share(strange, "false_name"),
            "leave_one_out_refused": share(alone, "refused"),
            "ambiguous_answered": share(by.get("gauge", [])),
            "not_excited_answered": share(by.get("still", [])),
        },
    }


def _closed(row: dict[str, Any], regime: str) -> float | None:
    """Closed part of the gap; nothing is closed where nothing was named, and None where there was no gap there."""
    found = row[f"closed_{regime}"]
    return 0.0 if found is None and row["verdict"] in ("unexplained", "not_excited", "crashed", "no_gap") else found
