"""The API's pages come out of the docstrings without a complaint."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("freeart21", "generator", "reconstruct", "export", "leaderboard", "simgap")


def test_every_module_has_a_page_and_pdoc_warns_of_nothing(tmp_path):
    command = ["make", "--silent", "docs", f"DOCS={tmp_path}", f"PDOC={sys.executable} -m pdoc --no-show-source"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert (done.returncode, done.stderr) == (0, "")
    for name in PACKAGES:
        for module in (ROOT / name).rglob("*.py"):
            page = module.parent if module.name == "__init__.py" else module.with_suffix("")
            if not any(part.startswith("_") for part in page.relative_to(ROOT).parts):
                assert (tmp_path / page.relative_to(ROOT)).with_suffix(".html").is_file(), module
