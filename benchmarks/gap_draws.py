"""Every sealed draw of `gap_names` in one table: its counts, at the code of its day, and all of them pooled.

    .venv/bin/python -m benchmarks.gap_draws          prints the table and the pooled counts

A draw's cases are not kept but for the newest (simgap.json): seed and commit make them again.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from benchmarks.common import RESULTS
from benchmarks.gap_score import wilson
from freeart21.files.atomic import write_json
from freeart21.files.checked import read_json

DRAWS = RESULTS / "simgap-draws.json"
_KEPT = (
    "nulls", "false_alarms", "false_names_on_nulls", "repairs_that_hurt", "crashes",
    "closed_fraction_median", "closed_fraction_other_regime_median", "seconds_per_verdict_median", "minutes",
)  # fmt: skip


def row_of(result: dict[str, Any]) -> dict[str, Any]:
    """One draw as a row of the table: who and when, and every count as [k, n].

    `result` is what `gap_names` writes. `clear_by_effect` has, of each effect, the clear singles named exactly.
    """
    found = result["summary"]
    counts = {name: [value["k"], value["n"]] for name, value in found["intervals"].items()}
    counts["parameters_in_interval"] = [found["interval_coverage"]["k"], found["interval_coverage"]["n"]]
    clear = [r for r in result["rows"] if r["stratum"] in ("single", "kinematic") and r["strength"] == "clear"]
    drawn, right = (Counter(r["truth"][0] for r in rows) for rows in (clear, [r for r in clear if r["right"]]))
    return {
        "seed": result["settings"]["seed"],
        "share": result["settings"]["share"],
        "commit": result["commit"],
        "cases": len(result["rows"]),
        **{name: found[name] for name in _KEPT},
        "counts": counts,
        "clear_by_effect": {name: [right[name], drawn[name]] for name in sorted(drawn)},
    }


def append(result: dict[str, Any], file: Path = DRAWS) -> None:
    """Add a draw to the table, in place of an earlier one of its seed, share and commit."""
    row = row_of(result)
    known = read_json(file)["rows"] if file.is_file() else []
    who = ("seed", "share", "commit")
    rows = [*(r for r in known if any(r[key] != row[key] for key in who)), row]
    write_json(file, {"summary": pooled(rows), "rows": rows})


def pooled(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """All draws as one: sums, and for counts their share with Wilson's 95 % interval."""

    def joined(key: str) -> dict[str, Any]:
        names = sorted({name for row in rows for name in row[key]})
        sums = {n: [sum(row[key].get(n, (0, 0))[i] for row in rows) for i in (0, 1)] for n in names}
        return {
            name: {"k": k, "n": n, "share": k / n if n else None, "wilson95": list(wilson(k, n))}
            for name, (k, n) in sums.items()
        }

    whole = ("cases", "nulls", "false_alarms", "false_names_on_nulls", "repairs_that_hurt", "crashes")
    return {
        "draws": len(rows),
        **{name: sum(row[name] for row in rows) for name in whole},
        **joined("counts"),
        "clear_by_effect": joined("clear_by_effect"),
    }


def show(file: Path = DRAWS) -> None:
    """Print the table: a row a draw, and the pooled counts last."""
    from rich.console import Console
    from rich.table import Table

    data = read_json(file)
    names = ("clear_singles_top1", "pairs_exact", "out_of_library_false_names", "leave_one_out_refused")
    table = Table("seed", "commit", "cases", *(n.replace("_", " ") for n in names), "false alarms", "hurt")

    def add(seed: str, commit: str, row: dict[str, Any], counts: dict[str, tuple[int, int]]) -> None:
        cells = ("{} of {}".format(*counts[n]) if n in counts else "-" for n in names)
        alarms, hurt = f"{row['false_alarms']} of {row['nulls']}", str(row["repairs_that_hurt"])
        table.add_row(seed, commit, str(row["cases"]), *cells, alarms, hurt)

    for row in data["rows"]:
        add(str(row["seed"]), row["commit"], row, row["counts"])
    together = data["summary"]
    add("all", "", together, {n: (together[n]["k"], together[n]["n"]) for n in names})
    Console().print(table)


if __name__ == "__main__":
    show()
