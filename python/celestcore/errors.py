"""The exceptions and the warning of celestcore: one family, so one ``except`` catches them all.

``InputError`` and ``LogFormatError`` are also ``ValueError``, ``NumericalError`` is also
``ArithmeticError`` and ``MissingDependencyError`` is also ``ImportError``.
"""

from __future__ import annotations

from typing import Any, TypeVar

__all__ = [
    "CelestcoreError",
    "CelestcoreWarning",
    "InputError",
    "LogFormatError",
    "MissingDependencyError",
    "NumericalError",
]

_InputErrorT = TypeVar("_InputErrorT", bound="InputError")


class CelestcoreError(Exception):
    """Base of every error that celestcore raises on purpose.

    Keyword details (where it happened, which value) are kept as attributes and put in front of
    the message. They survive pickling.

    Parameters
    ----------
    message : str
        What happened and what to do.

    Examples
    --------
    >>> import celestcore as cc
    >>> try:
    ...     cc.Gyro(arw=-1.0)
    ... except cc.CelestcoreError as error:
    ...     print(error)
    gyro.arw, value -1.0: must be greater than 0
    """

    def __init__(self, message: str = "") -> None:
        super().__init__(message)
        self.message = message

    def _where(self) -> list[str]:
        return []

    def __str__(self) -> str:
        where = ", ".join(self._where())
        return f"{where}: {self.message}" if where else self.message

    def __reduce__(self) -> tuple[Any, ...]:
        return (_rebuild, (type(self), self.message, dict(self.__dict__)))


class InputError(CelestcoreError, ValueError):
    """A value that was passed in, or read from a file, cannot be used.

    Parameters
    ----------
    message : str
        What is wrong and what to do; the details below are put in front of it.
    field : str, optional
        What was wrong, for example ``"gyro.t"``.
    row : int, optional
        Its row, counted from 0 in the arrays as they were given.
    value : object, optional
        The offending value.
    source : str, optional
        The file it came from.

    Examples
    --------
    >>> print(InputError("times must increase", field="gyro.t", row=17, value=3.0))
    gyro.t, row 17, value 3.0: times must increase
    """

    def __init__(
        self,
        message: str = "",
        *,
        field: str | None = None,
        row: int | None = None,
        value: object = None,
        source: str | None = None,
    ) -> None:
        super().__init__(message)
        self.field = field
        self.row = None if row is None else int(row)
        self.value = value
        self.source = source

    def _where(self) -> list[str]:
        parts = [] if self.field is None else [self.field]
        if self.row is not None:
            parts.append(f"row {self.row}")
        if self.value is not None:
            parts.append(f"value {_plain(self.value)}")
        return parts

    def __str__(self) -> str:
        text = super().__str__()
        return f"{self.source}: {text}" if self.source else text

    def located(self: _InputErrorT, source: str) -> _InputErrorT:
        """Return the same error with the name of the file it came from.

        Parameters
        ----------
        source : str
            The file.

        Returns
        -------
        InputError
            A copy, of the same class.

        Examples
        --------
        >>> print(InputError("must be positive", field="gyro.arw").located("mine.toml"))
        mine.toml: gyro.arw: must be positive
        """
        error: _InputErrorT = _rebuild(type(self), self.message, dict(self.__dict__))
        error.source = source
        return error


class LogFormatError(InputError):
    """A file cannot be read or written as a log: not there, truncated, columns missing.

    Examples
    --------
    >>> import celestcore as cc
    >>> try:
    ...     cc.read_log("not_there.npz")
    ... except cc.LogFormatError as error:
    ...     print(error)
    not_there.npz...
    """


class NumericalError(CelestcoreError, ArithmeticError):
    """The arithmetic of a filter broke down, for example a covariance not positive definite.

    Parameters
    ----------
    message : str
        What happened and what to do.
    step : int, optional
        The step of the run, counted from 0.
    time : float, optional
        The time of that step [s since the log's epoch].

    Examples
    --------
    >>> print(NumericalError("the covariance is not positive definite", step=3, time=1.5))
    step 3, t = 1.5 s: the covariance is not positive definite
    """

    def __init__(
        self, message: str = "", *, step: int | None = None, time: float | None = None
    ) -> None:
        super().__init__(message)
        self.step = step
        self.time = time

    def _where(self) -> list[str]:
        parts = [] if self.step is None else [f"step {self.step}"]
        if self.time is not None:
            parts.append(f"t = {self.time:.12g} s")
        return parts


class MissingDependencyError(CelestcoreError, ImportError):
    """An optional package is needed for this and is not installed.

    Examples
    --------
    >>> issubclass(MissingDependencyError, ImportError)
    True
    """


class CelestcoreWarning(UserWarning):
    """Something was accepted that is probably a mistake.

    Examples
    --------
    >>> import warnings
    >>> import celestcore as cc
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     gyro = cc.Gyro(arw=0.3)
    >>> caught[0].category.__name__
    'CelestcoreWarning'
    """


def _rebuild(cls: type[Any], message: str, state: dict[str, Any]) -> Any:
    error = cls(message)
    error.__dict__.update(state)
    return error


def _plain(value: object) -> str:
    """Format a value without numpy's type names: ``3.0``, ``(1.0, 0.0)``, ``'deg'``."""
    convert = getattr(value, "tolist", None)
    if callable(convert):
        value = convert()
    if isinstance(value, list | tuple):
        return "(" + ", ".join(_plain(v) for v in value) + ")"
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
