"""How well `freeart21 gap` names what is hidden by a world that shares nothing with it: draw, ask, score.

    python -m benchmarks.second_gap --seed 1 --share 0.1 --out DIR    # a development draw, some 34 cases
    python -m benchmarks.second_gap --release --out DIR          # the release's 112 cases: scored once, tuned on never

A draw that was stopped goes on where it was. Labels lie in DIR-sealed and are read when all answers are hashed. The
world itself is `benchmarks/second_world`; its docstring says how it was made, and what it may not be changed for. Never
use the release's seed for anything else: a draw that was looked at is a development draw.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

from benchmarks.second_world import asked, seal, tables
from benchmarks.second_world.draw import TooFaint, specs
from benchmarks.second_world.grade import grade

RELEASE = 320_001  # the seed of the release's draw, not run while the world was made
RELEASE_SHARE = 1 / 3  # of the full draw, which takes three hours of two cores
RESULTS = Path(__file__).parent / "results"


def _draw(seed: int, share: float, out: Path, sealed: Path, jobs: int) -> int:
    """All cases, written, but those that no machine shows; how many there are."""
    todo, salt, drawn = specs(share, seed), seal.salt_in(sealed), []
    if (out / "manifest.json").is_file():
        return len(json.loads((out / "manifest.json").read_text())["cases"])
    with ProcessPoolExecutor(jobs) as pool:
        made = [pool.submit(seal.make, spec, seed, i, salt, out, sealed) for i, spec in enumerate(todo)]
        for i, done in enumerate(made):
            try:
                done.result()
                drawn.append(i)
            except TooFaint as error:
                print(f"left out: {error}", file=sys.stderr, flush=True)
    seal.close(seed, salt, drawn, out, sealed)
    return len(drawn)


def _ask(out: Path, jobs: int, limit: float) -> None:
    """All answers; a line each."""
    names = json.loads((out / "manifest.json").read_text())["cases"]

    def one(name: str) -> None:
        doc = asked.ask(out / "cases" / name, out / "answers" / f"{name}.json", limit)
        said = doc["verdict"]["verdict"] if doc["verdict"] else doc["error"]
        print(f"{name} {doc['seconds']:6.1f} s  {said}", file=sys.stderr, flush=True)

    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(one, names))
    seal.seal_answers(out)


def _commit() -> str:
    here = Path(__file__).parent
    said = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=here, capture_output=True, text=True, check=False
    ).stdout.strip()
    changed = subprocess.run(
        ["git", "status", "--porcelain", "-uno"], cwd=here, capture_output=True, text=True, check=False
    ).stdout
    return said + ("+changes" if changed.strip() else "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--share", type=float, default=0.1, help="of the full draw of 336 cases")
    parser.add_argument("--release", action="store_true", help="the release's draw: its own seed, a third of all cases")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--limit", type=float, default=asked.LIMIT, help="seconds an answer may take")
    parser.add_argument(
        "--results", type=Path, help="[benchmarks/results/second_gap.json, second_gap-dev.json of others]"
    )
    args = parser.parse_args()
    seed, share = (RELEASE, RELEASE_SHARE) if args.release else (args.seed, args.share)
    if seed == RELEASE and not args.release:
        parser.error(f"--seed: {RELEASE} is the release's; run it with --release, or take another")
    settings = {"seed": seed, "share": share}
    sealed, began = args.out.with_name(args.out.name + "-sealed"), time.time()
    drawn = sealed / "settings.json"
    if drawn.is_file() and json.loads(drawn.read_text()) != settings:
        parser.error(f"--out: {args.out} holds another draw, {json.loads(drawn.read_text())}")
    seal.write_json(drawn, settings)
    count = _draw(seed, share, args.out, sealed, args.jobs)
    print(f"{count} cases drawn, {time.time() - began:.0f} s", file=sys.stderr, flush=True)
    _ask(args.out, args.jobs, args.limit)
    labels, answers = seal.opened(args.out, sealed)
    rows = [{"case": name, **grade(labels[name], answers[name])} for name in sorted(labels)]
    print("\n".join(tables.lines(rows)))
    doc = {
        "made_with": {
            "commit": _commit(),
            "machine": platform.machine(),
            "processor": platform.processor(),
            "python": platform.python_version(),
        },
        "settings": settings | {"limit_s": args.limit, "cases": count, "jobs": args.jobs, "release": args.release},
        "manifest_sha256": seal.sha256(args.out / "manifest.json"),
        "answers_sha256": seal.sha256(args.out / "answers.json"),
        "goals": tables.GOALS,
        "figures": tables.figures(rows),
        "medians": tables.medians(rows),
        "confusions": tables.confusions(rows),
        "rows": rows,
    }
    seal.write_json(args.results or RESULTS / ("second_gap.json" if args.release else "second_gap-dev.json"), doc)


if __name__ == "__main__":
    main()
