"""Writes the classifiers on docs/notes/classifiers.md from their docstrings and signatures.

    python docs/tools/parts_page.py

They stand between two comments of the page; all else of it stays.
"""

from __future__ import annotations

import re
from pathlib import Path

from bench.described import classifiers, markdown

PAGE = Path(__file__).parent.parent / "notes" / "classifiers.md"
WRITTEN = re.compile(r"(<!-- classifiers: docs/tools/parts_page.py -->\n).*(\n<!-- end of classifiers -->)", re.DOTALL)


def written(page: str) -> str:
    """The page with the classifiers as the code has them."""
    parts = "\n".join(markdown("models", name) for name in classifiers())
    return WRITTEN.sub(lambda found: f"{found[1]}\n{parts}{found[2]}", page)


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
