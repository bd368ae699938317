"""Make ``data/EGM2008.gfc`` of the package, 70x70, from a larger ICGEM file of EGM2008.

``python tools/build_egm2008.py FILE``, for instance ``data/gravity_models/EGM2008_120.gfc`` of the
crate ``brahe``. Kept are the header's constants and, per degree and order up to 70, the two
coefficients. The digits are the file's own.
"""

from __future__ import annotations

import sys
from pathlib import Path

TARGET = Path(__file__).parent.parent / "python" / "celestcore" / "data" / "EGM2008.gfc"
DEGREE = 70
CONSTANTS = {
    "modelname": "EGM2008",
    "earth_gravity_constant": "0.3986004415E+15",
    "radius": "0.63781363E+07",
    "norm": "fully_normalized",
    "tide_system": "tide_free",
}
HEADER = f"""\
product_type gravity_field
modelname EGM2008
earth_gravity_constant 0.3986004415E+15
radius 0.6378136300E+07
max_degree {DEGREE}
norm fully_normalized
tide_system tide_free
errors no
key L M C S
end_of_head
"""


def check(lines: list[str]) -> None:
    """Stop unless the file's header gives the constants that ours will give."""
    head = dict(f[:2] for f in (line.split() for line in lines[:40]) if len(f) == 2)
    for key, value in CONSTANTS.items():
        if head.get(key) != value:
            sys.exit(f"{key} is {head.get(key)}, not {value}")


def plain(text: str) -> str:
    """Return a coefficient with its 15 digits, or 0."""
    return f"{float(text):.14e}" if float(text) else "0"


def main() -> None:
    """Write the file."""
    source = Path(sys.argv[1]).read_text().splitlines()
    check(source)
    lines = []
    for line in source:
        fields = line.split()
        if len(fields) >= 5 and fields[0] == "gfc" and 2 <= int(fields[1]) <= DEGREE:
            c, s = (plain(x) for x in fields[3:5])
            lines.append(f"gfc {fields[1]} {fields[2]} {c} {s}\n")
    TARGET.write_text(HEADER + "".join(lines))
    print(f"{TARGET}: {len(lines)} coefficient pairs")


if __name__ == "__main__":
    main()
