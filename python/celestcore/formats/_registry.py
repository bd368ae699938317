"""The formats that celestcore knows, and those that other packages bring."""

from __future__ import annotations

import functools
import importlib
import importlib.util
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from celestcore._check import warn
from celestcore.errors import InputError, LogFormatError
from celestcore.formats._model import Source, name_of, opened

GROUP = "celestcore.readers"
_HEAD = 4096
_BUILT_IN = __package__ or "celestcore.formats"


@dataclass(frozen=True, kw_only=True)
class Format:
    """A kind of file: how it is recognised, and what reads it.

    Another package adds one by an entry point of the group ``celestcore.readers`` that names a
    `Format`.

    Parameters
    ----------
    name : str
        What ``open_log(..., format=)`` takes.
    summary : str
        A line that says what it is.
    read : callable, optional
        ``read(source, **options)`` takes a path or a binary file object and returns a `Source`.
    suffixes : tuple of str
        Endings of file names, such as ``".csv"``, small letters.
    detect : callable, optional
        ``detect(path, head)`` says whether a path is of this format; `head` is the beginning of the
        file, empty for a directory. Without it the suffix decides.
    writes : bool
        Whether `celestcore.write_log` or `export` writes it.
    needs : str, optional
        The package that it needs, by its import name.
    extra : str, optional
        The extra of celestcore that installs it.

    Examples
    --------
    >>> from pathlib import Path
    >>> mine = Format(name="mine", summary="my own", suffixes=(".mine",))
    >>> mine.matches(Path("log.mine"), b"")
    True
    """

    name: str
    summary: str
    read: Callable[..., Source] | None = None
    suffixes: tuple[str, ...] = ()
    detect: Callable[[Path, bytes], bool] | None = None
    writes: bool = False
    needs: str | None = None
    extra: str | None = None

    def matches(self, path: Path, head: bytes) -> bool:
        """Say whether a path is of this format.

        Parameters
        ----------
        path : Path
            The path.
        head : bytes
            The beginning of the file.

        Examples
        --------
        >>> from pathlib import Path
        >>> formats()["csv"].matches(Path("a.csv"), b"")
        True
        """
        if self.detect is not None:
            return self.detect(path, head)
        return path.suffix.lower() in self.suffixes

    @property
    def missing(self) -> str | None:
        """How to install what this format needs and is not there; None if nothing is missing."""
        if self.needs is None or importlib.util.find_spec(self.needs) is not None:
            return None
        return f"pip install 'celestcore[{self.extra}]'" if self.extra else f"install {self.needs}"


def _lazy(module: str) -> Callable[..., Source]:
    def read(source: Any, **options: Any) -> Source:
        reader: Callable[..., Source] = importlib.import_module(f"{_BUILT_IN}.{module}").read
        known = list(inspect.signature(reader).parameters)[1:]
        for name in options:
            if name not in known:
                takes = ", ".join(n for n in known if n != "kind") or "none"
                raise InputError(f"is no option of this format, which takes {takes}", field=name)
        return reader(source, **options)

    return read


def _is_parquet(path: Path, head: bytes) -> bool:
    return path.is_dir() or path.suffix.lower() == ".parquet"


def _is_message(kind: str) -> Callable[[Path, bytes], bool]:
    def detect(path: Path, head: bytes) -> bool:
        return f"CCSDS_{kind}_VERS".encode() in head

    return detect


def _is_sentinel(path: Path, head: bytes) -> bool:
    return path.suffix.lower() == ".xml" and b"<adsHeader>" in head and b"<missionId>" in head


def _is_ck(path: Path, head: bytes) -> bool:
    return head.startswith(b"DAF/CK")


_MESSAGE = {"suffixes": (".kvn", ".xml"), "writes": True, "needs": "ccsds_ndm", "extra": "ccsds"}
_FORMATS = (
    Format(
        name="parquet",
        summary="a directory of Parquet files or datasets, one per sensor; one Parquet file",
        read=_lazy("_parquet"),
        suffixes=("/", ".parquet"),
        detect=_is_parquet,
        writes=True,
        needs="pyarrow",
        extra="parquet",
    ),
    Format(
        name="csv",
        summary="one table of comma-separated values, all sensors on one time column",
        read=_lazy("_csv"),
        suffixes=(".csv",),
        writes=True,
        needs="pyarrow",
        extra="parquet",
    ),
    Format(
        name="npz",
        summary="numpy arrays, one per column",
        read=_lazy("_npz"),
        suffixes=(".npz",),
        writes=True,
    ),
    Format(
        name="hdf5",
        summary="HDF5, one group per sensor",
        read=_lazy("_hdf5"),
        suffixes=(".h5", ".hdf5"),
        writes=True,
        needs="h5py",
        extra="hdf5",
    ),
    Format(
        name="aem",
        summary="CCSDS Attitude Ephemeris Message",
        read=_lazy("_ccsds"),
        detect=_is_message("AEM"),
        **{**_MESSAGE, "suffixes": (".aem", ".kvn", ".xml")},  # type: ignore[arg-type]
    ),
    Format(
        name="oem",
        summary="CCSDS Orbit Ephemeris Message",
        read=_lazy("_ccsds"),
        detect=_is_message("OEM"),
        **{**_MESSAGE, "suffixes": (".oem", ".kvn", ".xml")},  # type: ignore[arg-type]
    ),
    Format(
        name="sentinel1",
        summary="Sentinel-1 annotation: orbit, attitude and rates",
        read=_lazy("_sentinel1"),
        suffixes=(".xml",),
        detect=_is_sentinel,
    ),
    Format(
        name="packets",
        summary="CCSDS space packets, with an XTCE definition and a map to columns",
        read=_lazy("_packets"),
        suffixes=(".dat", ".dat1", ".pkts", ".pds", ".tlm"),
        needs="space_packet_parser",
        extra="packets",
    ),
    Format(
        name="ck",
        summary="SPICE C-kernel",
        read=_lazy("_spice"),
        suffixes=(".bc",),
        detect=_is_ck,
        needs="spiceypy",
        extra="spice",
    ),
    Format(
        name="msopck",
        summary="table of quaternions from which msopck makes a SPICE C-kernel",
        suffixes=(".msopck",),
        writes=True,
    ),
)


def formats() -> dict[str, Format]:
    """Return all formats by name, the built-in ones first.

    Returns
    -------
    dict of str to Format
        A format of another package that cannot be loaded is left out with a warning.

    Examples
    --------
    >>> formats()["hdf5"].suffixes
    ('.h5', '.hdf5')
    """
    known = {f.name: f for f in _FORMATS}
    for entry in entry_points(group=GROUP):
        found = _loaded(entry)
        if found is not None and found.name not in known:
            known[found.name] = found
        elif found is not None:
            warn(f"the reader {entry.value!r} calls itself {found.name!r}, as another one does")
    return known


@functools.cache
def _loaded(entry: EntryPoint) -> Format | None:
    try:
        found = entry.load()
    except Exception as error:  # a broken package must not break celestcore
        warn(f"the reader {entry.value!r} cannot be loaded: {error}")
        return None
    if not isinstance(found, Format):
        warn(f"the reader {entry.value!r} is no celestcore.formats.Format")
        return None
    return found


def choose(source: Any, name: str | None) -> Format:
    """Return the format that is asked for, or that a path is found to have.

    Raises
    ------
    LogFormatError
        If there is none of that name, or none that fits.
    """
    known = formats() if name is not None else {f.name: f for f in _FORMATS}
    if name is not None:
        if name not in known or known[name].read is None:
            readable = ", ".join(n for n, f in known.items() if f.read is not None)
            raise InputError(f"is not one of {readable}", field="format", value=name)
        return known[name]
    if not isinstance(source, Path):
        raise InputError("is needed to read from a file object", field="format")
    head = _head(source)
    for group in (known, formats()):
        for found in group.values():
            if found.read is not None and found.matches(source, head):
                return found
    if not source.exists() and not source.suffix:
        raise LogFormatError("there is no such file or directory", source=str(source))
    raise LogFormatError(
        "is no kind of log; known are NAME.npz, NAME.csv, a directory of Parquet files and what "
        "'celestcore formats' lists",
        source=str(source),
    )


def _head(path: Path) -> bytes:
    if not path.is_file():
        return b""
    try:
        with opened(path) as stream:
            return stream.read(_HEAD)
    except OSError as error:
        raise LogFormatError(
            f"cannot be read: {error.strerror or error}", source=name_of(path)
        ) from None


def table() -> list[dict[str, Any]]:
    """Return what ``celestcore formats --json`` writes: one plain dictionary per format.

    Examples
    --------
    >>> table()[2]["name"], table()[2]["suffixes"]
    ('npz', ['.npz'])
    """
    return [
        {
            "name": f.name,
            "summary": f.summary,
            "suffixes": list(f.suffixes),
            "reads": f.read is not None,
            "writes": f.writes,
            "install": f.missing,
        }
        for f in formats().values()
    ]
