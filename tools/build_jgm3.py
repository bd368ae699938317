"""Make ``data/JGM3.gfc`` of the package from an ICGEM file of JGM-3.

``python tools/build_jgm3.py FILE``, for instance ``satkit_data/data/JGM3.gfc`` of the PyPI package
``satkit-data``. Kept are the header's constants and, per degree and order, the two coefficients.
"""

from __future__ import annotations

import sys
from pathlib import Path

TARGET = Path(__file__).parent.parent / "python" / "celestcore" / "data" / "JGM3.gfc"
HEADER = """\
product_type gravity_field
modelname JGM3
earth_gravity_constant 0.3986004415E+15
radius 0.6378136300E+07
max_degree 70
norm fully_normalized
tide_system zero_tide
errors no
key L M C S
end_of_head
"""


def main() -> None:
    """Write the file."""
    lines = []
    for line in Path(sys.argv[1]).read_text().splitlines():
        fields = line.split()
        if len(fields) >= 5 and fields[0] == "gfc" and int(fields[1]) >= 2:
            c, s = (f"{float(x):.12e}" if float(x) else "0" for x in fields[3:5])
            lines.append(f"gfc {fields[1]} {fields[2]} {c} {s}\n")
    TARGET.write_text(HEADER + "".join(lines))
    print(f"{TARGET}: {len(lines)} coefficient pairs")


if __name__ == "__main__":
    main()
