"""The process `freeart21`: hears a stop signal from the first moment, before anything large is loaded."""

from __future__ import annotations

import signal

from freeart21 import stopping


def main() -> None:
    """Run the command line."""
    stopping.listen()
    from freeart21.ending import in_one_line

    try:
        with in_one_line():
            from freeart21.cli import main as command

            command()
    finally:  # what is left is Python's own end
        for number in stopping.SIGNALS:
            signal.signal(number, signal.SIG_IGN)


if __name__ == "__main__":
    main()
