"""The options of the commands that read a log, as typer sees them."""

from __future__ import annotations

from typing import Annotated, Any, Optional

import typer

from celestcore._reading import from_words

PANEL = "How the log is read"

FormatName = Annotated[
    Optional[str],  # noqa: UP045 - typer on Python 3.10 needs it
    typer.Option(
        "--format",
        metavar="NAME",
        help="One that 'celestcore formats' lists; found by the file itself.",
        rich_help_panel=PANEL,
    ),
]
Reorder = Annotated[
    Optional[float],  # noqa: UP045
    typer.Option(
        "--reorder",
        metavar="S",
        help="Put rows up to S seconds late in place, leave out later and repeated ones.",
        rich_help_panel=PANEL,
    ),
]
Jump = Annotated[
    Optional[float],  # noqa: UP045
    typer.Option(
        "--jump",
        metavar="S",
        help="With --reorder: leave out up to 3 rows whose clock is off by more than S seconds.",
        rich_help_panel=PANEL,
    ),
]
Damaged = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option(
        "--damaged",
        metavar="raise|keep",
        help="Damage amid a file: an error, or keep what stands before it; raise.",
        rich_help_panel=PANEL,
    ),
]
Epoch = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option(
        "--epoch",
        metavar="TIME",
        help="Where times count from, such as 2026-01-01T00:00:00; wins over the log's.",
        rich_help_panel=PANEL,
    ),
]
StampWords = Annotated[
    Optional[list[str]],  # noqa: UP045
    typer.Option(
        "--stamps",
        metavar="[SENSOR:]KEY=VALUE,...",
        help="How times count: scale=UTC|TAI|GPS|TT, since=TIME, unit=S, bits=N of a counter that "
        "wraps. For all sensors, or once for each.",
        rich_help_panel=PANEL,
    ),
]
FormatOptions = Annotated[
    Optional[list[str]],  # noqa: UP045
    typer.Option(
        "--option",
        metavar="NAME=VALUE",
        help="An option of the format, such as definition=jpss.xml; several times if need be.",
        rich_help_panel=PANEL,
    ),
]


def chosen(
    format_name: str | None,
    reorder: float | None,
    jump: float | None,
    damaged: str | None,
    epoch: str | None,
    stamps: list[str] | None,
    options: list[str] | None,
) -> dict[str, Any]:
    """Return what `open_log` takes."""
    return from_words(
        stamps or (),
        options or (),
        format=format_name,
        reorder=reorder,
        jump=jump,
        damaged=damaged,
        epoch=epoch,
    )
