"""`freeart21 gap` on a case, as a user runs it: a process of its own, with a time limit."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.second_world.seal import write_json

LIMIT = 300.0  # s an answer may take; the goal for ten runs of 60 s is 60


def ask(case: Path, out: Path, limit: float = LIMIT) -> dict:
    """The answer to a case, kept in `out`, a file: verdict.json beside exit code, seconds and the last line of
    errors."""
    if out.is_file():
        return json.loads(out.read_text())
    with tempfile.TemporaryDirectory() as scratch:
        told = Path(scratch) / "case"  # without the id, and nothing beside it
        shutil.copytree(case, told)
        answer = Path(scratch) / "answer"
        command = [
            sys.executable,
            "-m",
            "freeart21",
            "gap",
            str(told / "machine.urdf"),
            str(told / "measured"),
            "--out",
            str(answer),
        ]
        began = time.monotonic()
        process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        try:
            _, errors = process.communicate(timeout=limit)
            code, last = process.returncode, (errors.strip().splitlines() or [""])[-1]
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            code, last = None, f"no answer in {limit:.0f} s"
        seconds = time.monotonic() - began
        file = answer / "verdict.json"
        verdict = json.loads(file.read_text()) if code == 0 and file.is_file() else None
    doc = {"exit": code, "seconds": round(seconds, 2), "error": last if verdict is None else "", "verdict": verdict}
    write_json(out, doc)
    return doc
