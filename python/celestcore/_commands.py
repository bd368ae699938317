"""The commands as typer sees them, and what they print. Imported by `cli` when typer is there."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Optional

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

from celestcore import _reading_options as options
from celestcore import cli
from celestcore.campaign._command import register
from celestcore.errors import InputError
from celestcore.solution import package_version
from celestcore.summary import headline, spell_time, summary
from celestcore.units import ARCSEC, DEG_PER_HOUR

app = typer.Typer(
    name="celestcore",
    help="Attitude and orbit of spacecraft from their sensors.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

Log = Annotated[
    Optional[Path],  # noqa: UP045 - typer on Python 3.10 needs it
    typer.Argument(
        metavar="LOG",
        help="A directory of Parquet tables, an .npz, a .csv or what 'celestcore formats' lists.",
    ),
]
Sample = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option("--sample", metavar="NAME", help="A log that celestcore ships: fermi, noaa20."),
]


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"celestcore {package_version()}")
        raise typer.Exit()


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    pass


@app.command(
    epilog="Example: celestcore replay --sample fermi -o fermi.parquet --report fermi.html"
)
def replay(
    log: Log = None,
    sample: Sample = None,
    kind: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--filter",
            metavar="KIND",
            help="ekf, ukf, and without GNSS srukf, iterated, invariant, literal; log's, or ekf.",
        ),
    ] = None,
    smooth: Annotated[
        bool, typer.Option("--smooth", help="Go forward and back: for work on the ground.")
    ] = False,
    config: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--config", metavar="FILE.toml", help="Settings that win over the log's."),
    ] = None,
    gate: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--gate", metavar="P", help="Reject fixes outside this probability, e.g. 0.9999."
        ),
    ] = None,
    period: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option("--period", metavar="S", help="Output period in s; every sample or fix."),
    ] = None,
    withhold: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--withhold",
            metavar="S",
            help="Also hide fixes for windows of S seconds, and tell the drift; GNSS: 60 and 600.",
        ),
    ] = None,
    output: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--output", "-o", metavar="OUT.parquet", help="Solution; GNSS: .npz, .csv."),
    ] = None,
    parts: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            "--parts",
            metavar="DIR",
            help="For logs of any length: window by window, results in parts in a folder.",
        ),
    ] = None,
    checkpoint: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--checkpoint", metavar="FILE", help="With --parts: remember how far it is."),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="With --checkpoint: go on to the same bits.")
    ] = False,
    window: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--window", metavar="S", help="With --parts: length in s; what holds 100 000 samples."
        ),
    ] = None,
    every: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(
            "--every", metavar="N", help="With --parts: a row every N samples, or fixes' times."
        ),
    ] = None,
    interval: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--interval", metavar="S", help="With --checkpoint: least time between two in s."
        ),
    ] = None,
    report: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--report", metavar="OUT.html|.png", help="Write a report with pictures."),
    ] = None,
    json_file: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--json", metavar="FILE", help="Write the summary; - for standard output."),
    ] = None,
    format_name: options.FormatName = None,
    reorder: options.Reorder = None,
    jump: options.Jump = None,
    damaged: options.Damaged = None,
    epoch: options.Epoch = None,
    stamps: options.StampWords = None,
    option: options.FormatOptions = None,
) -> None:
    """Estimate attitude and gyro bias, or orbit and attitude, over a whole log."""
    reading = options.chosen(format_name, reorder, jump, damaged, epoch, stamps, option)
    of_parts = {"--window": window, "--every": every, "--interval": interval}
    if parts is not None or checkpoint is not None or resume:
        if interval is not None and checkpoint is None:
            raise InputError("goes with --checkpoint FILE", field="--interval")
        from celestcore._parts_command import replay_parts

        others: dict[str, object] = {"--output": output, "--withhold": withhold}
        others |= {"--period": period, "--sample": sample}
        replay_parts(
            (log, parts, checkpoint),
            {
                "resume": resume,
                "window": window,
                "every": 1 if every is None else every,
                "smooth": smooth,
                "interval": 30.0 if interval is None else interval,
            },
            {
                "config": config,
                "filter": kind,
                "gate": gate,
                "json": json_file,
                "reading": reading,
                "report": report,
            },
            others,
            shlex.join(_command()),
        )
        return
    for name, value in of_parts.items():
        if value is not None:
            raise InputError("goes with --parts DIR", field=name, value=value)
    request = cli.Replay(
        *(log, sample, kind, config, gate, period, withhold, output, report, json_file, smooth),
        reading=reading,
    )
    request.check()
    sensors, settings = request.load()
    if request.by_gnss(sensors, settings):
        from celestcore._gnss_command import replay_gnss

        with _progress() as advance:
            replayed = request.run_gnss(sensors, settings, advance)
        replay_gnss(request, sensors, replayed, shlex.join(_command()))
        return
    with _progress() as advance:
        solution = request.run(sensors, settings, advance)
    with Console(stderr=True).status("hiding fixes, window by window"):
        drift = request.drift(sensors, settings)
    hidden = None if drift is None else drift.summary()
    nav = settings.navigator()
    result = summary(solution, sensors, gate=settings.gate(), withheld=hidden, navigator=nav)
    result["log"] = result["log"] or str(log)
    words = cli.describe_settings(settings)
    request.write(solution, result, drift=drift, settings=words, command=shlex.join(_command()))
    console = Console(stderr=json_file == cli.STDOUT, highlight=False, markup=False)
    _show_replay(console, result)
    for name, path in request.written():
        console.print(f"{name}: {path}", soft_wrap=True)


@app.command(epilog="Example: celestcore info --sample fermi")
def info(
    log: Log = None,
    sample: Sample = None,
    json_file: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--json", metavar="FILE", help="Write it as JSON; - for standard output."),
    ] = None,
    format_name: options.FormatName = None,
    reorder: options.Reorder = None,
    jump: options.Jump = None,
    damaged: options.Damaged = None,
    epoch: options.Epoch = None,
    stamps: options.StampWords = None,
    option: options.FormatOptions = None,
) -> None:
    """Say what a log holds."""
    from celestcore._info_command import tell

    reading = options.chosen(format_name, reorder, jump, damaged, epoch, stamps, option)
    tell(log, sample, json_file, reading)


@app.command(epilog="Example: celestcore formats --json -")
def formats(
    json_file: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--json", metavar="FILE", help="Write it as JSON; - for standard output."),
    ] = None,
) -> None:
    """Say which formats of logs are read and written, and what to install for them."""
    from celestcore.formats._listing import show, write

    write(json_file)
    if json_file != cli.STDOUT:
        show(Console(highlight=False, markup=False))


published = typer.Typer(
    help="Run published experiments again.", no_args_is_help=True, rich_markup_mode=None
)
app.add_typer(published, name="reproduce")


Seed = Annotated[int, typer.Option("--seed", metavar="S", help="Of all random numbers.")]
Threads = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option("--threads", metavar="N", help="Same figures for any number; all."),
]
Figures = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option("--json", metavar="FILE", help="Write every figure; - for standard output."),
]
Out = Annotated[
    Optional[Path],  # noqa: UP045
    typer.Option("--out", metavar="DIR", help="Write the page, its tables and its figures."),
]
Quick = Annotated[bool, typer.Option("--quick", help="Few runs: a look, too few to judge.")]


@published.command(
    "star-gyro",
    epilog="Example: celestcore reproduce star-gyro --out star-gyro --json star-gyro.json",
)
def star_gyro(
    runs: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option("--runs", metavar="N", help="Orbits a cell; 16, with --quick 1."),
    ] = None,
    seed: Seed = 0,
    threads: Threads = None,
    json_file: Figures = None,
    out: Out = None,
    quick: Quick = False,
) -> None:
    """Star camera and gyro: Tables 3 to 5 and Figures 2 to 7 of Wang and Jiang (2020)."""
    _reproduce("star-gyro", runs, seed, threads, quick, json_file, out)


@published.command(
    "celestial-orbit",
    epilog="Example: celestcore reproduce celestial-orbit --out orbit --json orbit.json",
)
def celestial_orbit(
    runs: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option("--runs", metavar="N", help="Runs a cell; 40, with --quick 2."),
    ] = None,
    seed: Seed = 0,
    threads: Threads = None,
    json_file: Figures = None,
    out: Out = None,
    quick: Quick = False,
) -> None:
    """Orbit from stars and horizon: Tables 1 to 3 and Figures 3 and 4 of Ning and Ma (2010)."""
    _reproduce("celestial-orbit", runs, seed, threads, quick, json_file, out)


@published.command(
    "gnss-star",
    epilog="Example: celestcore reproduce gnss-star --out gnss --json gnss.json",
)
def gnss_star(
    runs: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option("--runs", metavar="N", help="Runs a cell; 100, with --quick 2."),
    ] = None,
    seed: Seed = 0,
    threads: Threads = None,
    json_file: Figures = None,
    out: Out = None,
    quick: Quick = False,
) -> None:
    """GPS and star sensor: Tables 1 and 2 and Figures 3 to 7 of Zhang, Chen and Wang (2019)."""
    _reproduce("gnss-star", runs, seed, threads, quick, json_file, out)


def _reproduce(experiment: str, *options: Any) -> None:
    from celestcore.reproduce._command import Reproduce

    request = Reproduce(experiment, *options)
    request.check()
    with _progress("reproducing") as advance:
        result = request.run(None if advance is None else lambda a, b, _: advance(a, b))
    written = request.write(result, shlex.join(_command()))
    console = Console(stderr=request.json == cli.STDOUT, highlight=False, markup=False)
    console.print(request.lead(result))
    table = Table("block", "asked", "found", "", box=None, pad_edge=False, header_style="bold")
    for target in result.targets():
        verdict = {True: "met", False: "missed", None: "not judged"}[target.met]
        table.add_row(target.block, target.asked, target.found, verdict)
    console.print(table)
    for name, path in written:
        console.print(f"{name}: {path}", soft_wrap=True)


@app.command(
    epilog="Example: celestcore bench --against filterpy,numba --only mekf,ukf --json bench.json"
)
def bench(
    against: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Option(
            "--against",
            metavar="WHOM",
            help="Peers, e.g. filterpy,numba; all; or a program and its arguments that prints "
            'lines {"task": .., "peer": .., "ns": ..}. May be given several times.',
        ),
    ] = None,
    only: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--only", metavar="WORK,...", help="Some works, e.g. mekf,ukf; all."),
    ] = None,
    repeats: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option("--repeats", metavar="N", help="Rounds of everything in turn; 3."),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Small inputs, one run: too short to judge by.")
    ] = False,
    instructions: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            "--instructions", metavar="FILE", help="Counts that `make instructions` wrote."
        ),
    ] = None,
    json_file: Figures = None,
    markdown: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--markdown", metavar="FILE", help="Write a table for the documentation."),
    ] = None,
) -> None:
    """Measure celestcore, and others at the same work in the same run."""
    from celestcore.bench._command import Bench
    from celestcore.bench._table import show

    request = Bench(against or (), only, repeats, quick, instructions, json_file, markdown)
    request.check()
    with _progress("measuring") as advance:
        report = request.run(advance)
    written = request.write(report)
    console = Console(stderr=request.to_stdout, highlight=False, markup=False)
    show(console, report)
    for name, path in written:
        console.print(f"{name}: {path}", soft_wrap=True)


def _command() -> list[str]:
    return ["celestcore", *sys.argv[1:]]


@contextmanager
def _progress(what: str = "replaying") -> Iterator[cli.Progress | None]:
    """Give a callback that draws a bar on standard error, if that is a terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield None
        return
    columns = (TextColumn(what), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    bar = Progress(*columns, console=console, transient=True)
    task = bar.add_task(what, total=None)

    def advance(done: int, total: int) -> None:
        bar.start()  # short work never gets here, and shows no bar
        bar.update(task, completed=done, total=total)

    try:
        yield advance
    finally:
        if bar.live.is_started:
            bar.stop()


register(app, _progress)


def _show_replay(console: Console, result: dict[str, Any]) -> None:
    """Print a headline and a table of the summary."""
    counts, inn, final = result["counts"], result["innovation"], result["final"]
    console.print(result["log"] or "untitled log", style="bold")
    console.print(headline(result))
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold")
    table.add_column(justify="right")
    rows = [
        ("filter", result["filter"] + (", smoothed" if result["smoothed"] else "")),
        ("time covered", spell_time(result["span_s"])),
        ("gyro samples", f"{counts['samples']:,}"),
        ("fixes used", f"{counts['accepted']:,} of {counts['fixes']:,}"),
        ("fixes rejected / that set the start", _several(counts, "rejected", "start")),
        ("missing / outside / gyro gaps", _several(counts, "missing", "outside", "gaps")),
        ("innovation rms, body x y z [arcsec]", _numbers(inn["rms_arcsec"])),
        ("NIS per degree of freedom (ideal 1)", _numbers([inn["nis_per_dof"]])),
    ]
    if final:
        sigma = final["sigma"]
        rows += [
            ("final gyro bias, x y z [deg/h]", _numbers(final["bias"], DEG_PER_HOUR)),
            ("  its 1 sigma", _numbers(sigma[3:], DEG_PER_HOUR)),
            ("final attitude 1 sigma, x y z [arcsec]", _numbers(sigma[:3], ARCSEC)),
        ]
    if result["samples_per_second"]:
        rows.append(("speed [gyro samples/s]", f"{result['samples_per_second']:,.0f}"))
    withheld = result.get("withheld")
    if withheld:
        for name, key in (("with bias", "drift"), ("plain integration", "without_bias")):
            values = [withheld[f"{key}_{q}_arcsec"] for q in ("median", "95", "max")]
            rows.append((f"drift, {name}, median 95 % max [arcsec]", _numbers(values)))
    for row in rows:
        table.add_row(*row)
    console.print(table)


def _several(counts: dict[str, int], *names: str) -> str:
    return " / ".join(f"{counts[name]:,}" for name in names)


def _numbers(values: list[Any], unit: float = 1.0) -> str:
    return "  ".join(
        f"{value / unit:.4g}" if isinstance(value, int | float) else str(value or "n/a")
        for value in values
    )
