"""What the tests of `leaderboard.asset_process` ask: a process that answers, remembers, crashes, hangs or talks."""

import os
import sys
import tempfile
import time

from leaderboard import asset_process

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
        case "talk":
            os.write(1, b"x" * 300_000 + b"\n")
            return {"much": "y" * 300_000}
    return {
        "asked": len(ASKED),
        "pid": os.getpid(),
        "place": tempfile.gettempdir(),
        "threads": os.environ["OMP_NUM_THREADS"],
    }


def main():
    asset_process.serve(reply, ("json", "there_is_no_such_module"))
