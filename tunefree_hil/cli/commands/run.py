"""Commands that make or read runs: drive, tune, verify, replay. Each imports its job when it is called."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import (
    AsJson,
    Bench,
    BenchBus,
    Bus,
    Join,
    Model,
    Out,
    Plain,
    Realtime,
    RunPath,
    Seed,
    Session,
    record_from,
    session_of,
)
from tunefree_hil.cli.output import present


class SearchScale(StrEnum):
    """Scale on which the range of a parameter is searched."""

    log = "log"
    linear = "linear"


class Backend(StrEnum):
    """What the trials are driven with."""

    bus = "bus"
    batch = "batch"


class ParameterSet(StrEnum):
    """Set of tuned parameters (docs/reference/controller.md)."""

    mrac = "mrac"
    lateral = "lateral"
    complete = "complete"


Controller = Annotated[str, typer.Option(metavar="CMD", help="start this program instead of the built-in controller")]


def drive(
    bench: Bench,
    scenario: Annotated[list[str] | None, typer.Option(help="drive only this scenario; may be repeated")] = None,
    model: Model = None,
    bus: Bus = "auto",
    bench_bus: BenchBus = "",
    seed: Seed = None,
    realtime: Realtime = False,
    join: Join = False,
    session: Session = "",
    out: Out = None,
    parameter: Annotated[list[str] | None, typer.Option(help="NAME=VALUE; may be repeated")] = None,
    controller: Controller = "",
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Drive scenarios over the bus and score them."""
    arguments = locals()

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.drive import DriveOptions
        from tunefree_hil.jobs.drive import drive as run

        changes = {"parameters": parameter or (), "session": session_of(session, join)}
        return run(record_from(DriveOptions, arguments, **changes))

    return present("drive", job, plain=plain, as_json=as_json, first=f"drive {bench}")


def tune(
    bench: Annotated[Path | None, typer.Argument(help="bench file, such as bench_configs/mkz_steer.toml")] = None,
    trials: Annotated[int | None, typer.Option(min=1, help="number of trials; default: as in the bench file")] = None,
    set_name: Annotated[
        ParameterSet | None, typer.Option("--set", help="parameters to tune; default: as in the bench file")
    ] = None,
    sampler: Annotated[str | None, typer.Option(help="tpe_independent, tpe_relative or random")] = None,
    seed: Seed = None,
    scale: Annotated[
        SearchScale | None, typer.Option(help="scale of the search, default: log; the paper uses linear")
    ] = None,
    bus: Bus = "auto",
    bench_bus: BenchBus = "",
    join: Join = False,
    session: Session = "",
    out: Out = None,
    resume: Annotated[Path | None, typer.Option(help="continue the run in this folder, even a finished one")] = None,
    verify: Annotated[
        bool | None, typer.Option(help="verify the winner on the verify model at the end; default: yes")
    ] = None,
    study: Annotated[
        str | None, typer.Option(metavar="URL", help="work on a shared study: postgresql://USER@HOST/DATABASE#STUDY")
    ] = None,
    backend: Annotated[
        Backend, typer.Option(help="batch: compiled; the best trials are confirmed over the bus")
    ] = Backend.bus,
    benches: Annotated[int, typer.Option(min=0, help="benches side by side; 0: one per core, at most two")] = 0,
    in_flight: Annotated[int, typer.Option(min=0, help="trials in a generation; 0: as in the bench file")] = 0,
    realtime: Realtime = False,
    controller: Controller = "",
    confirm: Annotated[
        int | None, typer.Option(min=1, metavar="K", help="trials of a batch to confirm over the bus; default: 3")
    ] = None,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Find the parameters of the controller.

    Trial by trial on the bench; the run folder explains why the winner wins. The same command resumes an unfinished run
    and starts a new one after a finished run. --resume continues the given run, even a finished one (with more
    --trials).
    """
    arguments = locals()

    def job() -> Iterable[Event]:
        bench_file = _find_bench(bench, resume)
        from tunefree_hil.jobs.tune.options import TuneOptions
        from tunefree_hil.jobs.tune.tune import tune as run

        return run(record_from(TuneOptions, arguments, bench=bench_file, session=session_of(session, join)))

    return present("tune", job, plain=plain, as_json=as_json, first=f"tune {bench or resume or ''}".strip())


def _find_bench(bench: Path | None, resume: Path | None) -> Path:
    """The bench file that was given, or the copy in the run to resume."""
    if bench is not None:
        return bench
    if resume is not None:
        return resume / "bench.toml"
    benches = sorted(Path("bench_configs").glob("*.toml"))
    listed = ", ".join(str(path) for path in benches) or "bench_configs/NAME.toml"
    raise InputError("no bench file given", code="usage", key="BENCH", hint=f"give one of {listed}, or --resume RUN")


def verify(
    run: RunPath,
    bus: Bus = "auto",
    bench_bus: BenchBus = "",
    join: Join = False,
    session: Session = "",
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Drive the winner of a run on the verify model.

    The manual parameters are driven for comparison. Exit status 1 if one of them is better or the winner fails.
    """
    arguments = locals()

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.tune.options import VerifyOptions
        from tunefree_hil.jobs.tune.verify import verify as start_job

        return start_job(record_from(VerifyOptions, arguments, session=session_of(session, join)))

    return present("verify", job, plain=plain, as_json=as_json, first=f"verify {run}")


def replay(
    run: RunPath,
    episode: Annotated[int | None, typer.Option(help="number of the episode; default: all")] = None,
    verify: Annotated[bool, typer.Option("--verify", help="drive the run again and compare every frame")] = False,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Check the logs of a run.

    With --verify the run is driven again and every frame is compared. Exit status 1 if frames differ.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.replay import replay as start_job

        return start_job(run, episode=episode, verify=verify)

    return present("replay", job, plain=plain, as_json=as_json, first=f"replay {run}")
