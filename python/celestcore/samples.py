"""The real flight logs that the package ships; ``data/README.md`` says where they come from.

=========  ==========================================================================
name       what
=========  ==========================================================================
fermi      Fermi gamma-ray telescope, 2015-10-13, 12 h at 1 Hz: body rates, quaternions
noaa20     NOAA-20, 2021-04-09, 2 h at 1 Hz: GPS position and velocity, quaternions
=========  ==========================================================================
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from celestcore.errors import InputError

if TYPE_CHECKING:
    from celestcore.log import SensorLog

__all__ = ["sample", "sample_names", "sample_path"]


def sample_names() -> tuple[str, ...]:
    """Return the names of the samples, in alphabetical order.

    Examples
    --------
    >>> sample_names()
    ('fermi', 'noaa20')
    """
    folder = files("celestcore") / "data"
    names = (entry.name for entry in folder.iterdir())
    return tuple(sorted(n.removesuffix(".npz") for n in names if n.endswith(".npz")))


def sample_path(name: str) -> Path:
    """Return the path of a sample's NPZ file; its settings are in the TOML file beside it.

    Parameters
    ----------
    name : str
        One of `sample_names`.

    Raises
    ------
    InputError
        If there is no sample of that name; lists those there are.

    Examples
    --------
    >>> sample_path("fermi").name
    'fermi.npz'
    """
    names = sample_names()
    if name not in names:
        known = ", ".join(names)
        raise InputError(f"is not a sample; there are {known}", field="sample", value=name)
    return Path(str(files("celestcore") / "data" / f"{name}.npz"))


def sample(name: str) -> SensorLog:
    """Read one of the shipped logs, with the noise and frames that its settings give.

    Parameters
    ----------
    name : str
        One of `sample_names`.

    Raises
    ------
    InputError
        If there is no sample of that name; lists those there are.

    Examples
    --------
    >>> log = sample("fermi")
    >>> len(log.gyro.t), log.epoch
    (43195, '2015-10-13T08:00:00')
    """
    from celestcore.io import read_log

    return read_log(sample_path(name))
