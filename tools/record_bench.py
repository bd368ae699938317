"""Put a section that `celestcore bench --markdown FILE` wrote on top of the benchmarks' page.

A section of the same title is replaced: it is the same day, machine and version.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

PAGE = Path(__file__).resolve().parent.parent / "docs" / "benchmarks.md"
MARK = "<!-- newest section below: tools/record_bench.py -->\n"


def recorded(page: str, section: str) -> str:
    """Return the page with the section on top."""
    title = section.split("\n", 1)[0]
    if not title.startswith("## ") or MARK not in page:
        raise SystemExit("record_bench: this is no section of `celestcore bench --markdown`")
    same = re.escape(title) + r"\n.*?(?=^## |^<!-- older)"
    page = re.sub(same, "", page, flags=re.MULTILINE | re.DOTALL)
    before, after = page.split(MARK)
    return f"{before}{MARK}\n{section.strip()}\n\n{after.lstrip()}"


def main(arguments: list[str]) -> None:
    """Record the file that is named."""
    if len(arguments) != 1:
        raise SystemExit("usage: python tools/record_bench.py build/section.md")
    section = Path(arguments[0]).read_text(encoding="utf-8")
    PAGE.write_text(recorded(PAGE.read_text(encoding="utf-8"), section), encoding="utf-8")
    print(f"recorded in {PAGE.relative_to(PAGE.parent.parent)}")


if __name__ == "__main__":
    main(sys.argv[1:])
