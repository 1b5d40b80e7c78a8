"""The process `freeart21`. It handles stop signals from its first moment, before anything large is imported."""

import sys

from freeart21.search_path import search_path

sys.path[:] = search_path()  # `python -m` has put the working folder first

import os  # noqa: E402
import signal  # noqa: E402
from typing import Any  # noqa: E402


def _exit_at_once(number: int, frame: Any) -> None:
    print("freeart21: stopped", file=sys.stderr, flush=True)
    os._exit(128 + number)


if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, _exit_at_once)  # no work is in progress yet; `listen` replaces it

from freeart21 import processes  # noqa: E402


def main() -> None:
    """Run the command line."""
    processes.listen()
    from freeart21.processes import run_and_exit

    run_and_exit(_run_command)


def _run_command() -> None:
    from freeart21.errors import FreeArtError
    from freeart21.processes import report_errors
    from freeart21.search_path import replaced_package

    with report_errors():
        if (fault := replaced_package()) is not None:
            raise FreeArtError(fault)
        from freeart21.cli import main as command

        command()


if __name__ == "__main__":
    main()
