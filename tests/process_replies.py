"""What the tests of `leaderboard.forked` ask: a process that answers, remembers, crashes, hangs, talks or asks."""

import os
import sys
import tempfile
import time
from pathlib import Path

from leaderboard import forked

ASKED = []


def reply(request):
    ASKED.append(request)
    match request["do"]:
        case "hang":
            time.sleep(600)
        case "abort":
            print("about to break", file=sys.stderr, flush=True)
            os.abort()
        case "leave":
            os._exit(0)
        case "raise":
            raise ValueError("not caught by whoever replies")
        case "ask" | "ask a hanging one" as which:
            inner = {"do": "hang" if "hanging" in which else "answer"}
            return forked.Server("process_replies").ask(inner, Path(tempfile.gettempdir()), 60.0)
        case "talk":
            os.write(1, b"x" * 300_000 + b"\n")
            return {"much": "y" * 300_000}
    return {
        "asked": len(ASKED),
        "pid": os.getpid(),
        "parent": os.getppid(),
        "place": tempfile.gettempdir(),
        "threads": os.environ["OMP_NUM_THREADS"],
    }


def main():
    forked.serve(reply, ("json", "there_is_no_such_module"))
