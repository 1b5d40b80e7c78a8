"""The page (to come)."""
from pathlib import Path
def write_page(path: Path, verdict, found, seconds) -> None:
    path.write_text('<meta name="generator" content="freeart21">')
