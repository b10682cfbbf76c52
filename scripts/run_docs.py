"""Run the Python blocks of documentation pages, each page as one program, and stop at the first that fails."""

from __future__ import annotations

import argparse
import re
import sys
import time
from pathlib import Path

BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(text: str) -> list[tuple[int, str]]:
    """The line at which each Python block begins, and its text."""
    return [(text.count("\n", 0, found.start(1)) + 1, found.group(1)) for found in BLOCK.finditer(text)]


def run(page: Path) -> None:
    """Run a page's blocks one after the other in one namespace; a failure names the page's own line."""
    names: dict[str, object] = {"__name__": "__main__"}
    for line, text in blocks(page.read_text("utf-8")):
        begun = time.perf_counter()
        exec(compile("\n" * (line - 1) + text, str(page), "exec"), names)
        print(f"--- {page}:{line}: {time.perf_counter() - begun:.1f} s", file=sys.stderr)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pages", nargs="+", type=Path, metavar="PAGE.md")
    for page in parser.parse_args().pages:
        run(page)


if __name__ == "__main__":
    main()
