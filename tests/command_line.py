"""The command line `freeart21`, run in this process."""

import sys

import pytest

from freeart21 import cli, processes


def run_command(capture, *words) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of `freeart21 WORDS`; `capture` is pytest's capsys or capfd."""
    capture.readouterr()
    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit) as ended:
        patch.setattr(sys, "argv", ["freeart21", *map(str, words)])
        patch.setattr(processes, "listen", lambda: None)
        cli.main()
    code, shown = ended.value.code, capture.readouterr()
    if isinstance(code, str):  # as Python ends with a text
        return 1, shown.out, f"{shown.err}{code}\n"
    return int(code or 0), shown.out, shown.err
