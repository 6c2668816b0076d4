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
    session_of,
)
from tunefree_hil.cli.output import present


class Scale(StrEnum):
    """How a parameter's box is searched."""

    log = "log"
    linear = "linear"


class Backend(StrEnum):
    """What drives the trials."""

    bus = "bus"
    batch = "batch"


class ParameterSet(StrEnum):
    """Which parameters are tuned (interfaces 7)."""

    mrac = "mrac"
    lateral = "lateral"
    complete = "complete"


Controller = Annotated[str, typer.Option(metavar="CMD", help="start this program instead of our controller")]


def drive(
    bench: Bench,
    scenario: Annotated[list[str] | None, typer.Option(help="this scenario only, again for more")] = None,
    model: Model = None,
    bus: Bus = "auto",
    bench_bus: BenchBus = "",
    seed: Seed = None,
    realtime: Realtime = False,
    join: Join = False,
    session: Session = "",
    out: Out = None,
    parameter: Annotated[list[str] | None, typer.Option(help="NAME=VALUE, again for more")] = None,
    controller: Controller = "",
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Drive scenarios over the bus and score them."""

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.drive import Asked
        from tunefree_hil.jobs.drive import drive as run

        return run(
            Asked(
                bench=bench,
                scenario=scenario or (),
                model=model,
                bus=bus,
                bench_bus=bench_bus,
                seed=seed,
                realtime=realtime,
                join=join,
                session=session_of(session, join),
                out=out,
                parameters=parameter or (),
                controller=controller,
            )
        )

    return present("drive", job, plain=plain, as_json=as_json, first=f"drive {bench}")


def tune(
    bench: Annotated[Path | None, typer.Argument(help="bench file, such as bench_configs/mkz_steer.toml")] = None,
    trials: Annotated[int | None, typer.Option(min=1, help="how many trials; default: the bench file's")] = None,
    set_name: Annotated[ParameterSet | None, typer.Option("--set", help="which parameters")] = None,
    sampler: Annotated[str | None, typer.Option(help="tpe_independent, tpe_relative or random")] = None,
    seed: Seed = None,
    scale: Annotated[
        Scale | None, typer.Option(help="how the box is searched (log if not said); linear is the paper's")
    ] = None,
    bus: Bus = "auto",
    bench_bus: BenchBus = "",
    join: Join = False,
    session: Session = "",
    out: Out = None,
    resume: Annotated[Path | None, typer.Option(help="go on with this run folder, a finished one too")] = None,
    verify: Annotated[
        bool | None, typer.Option(help="drive the winner on the verify model at the end (yes if not said)")
    ] = None,
    study: Annotated[
        str | None, typer.Option(metavar="URL", help="work on a shared study: postgresql://USER@HOST/DATABASE#STUDY")
    ] = None,
    backend: Annotated[Backend, typer.Option(help="batch: compiled, its best confirmed over the bus")] = Backend.bus,
    benches: Annotated[int, typer.Option(min=0, help="benches side by side; 0: one a core, at most two")] = 0,
    in_flight: Annotated[int, typer.Option(min=0, help="trials asked together; 0: the bench file's")] = 0,
    realtime: Realtime = False,
    controller: Controller = "",
    confirm: Annotated[
        int | None, typer.Option(min=1, metavar="K", help="of a batch, how many the bus drives again (3 if not said)")
    ] = None,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Find the controller's parameters.

    Trial by trial over the bench; the run folder says why the winner wins. Stopped, the same command goes on where it
    was; finished, it starts anew. --resume goes on with the run that you name, a finished one too (with more --trials).
    """

    def job() -> Iterable[Event]:
        bench_file = _bench_of(bench, resume)
        from tunefree_hil.jobs.tune.options import Asked
        from tunefree_hil.jobs.tune.tune import tune as run

        return run(
            Asked(
                bench=bench_file,
                trials=trials,
                set_name=set_name.value if set_name else None,
                sampler=sampler,
                seed=seed,
                scale=scale.value if scale else None,
                bus=bus,
                bench_bus=bench_bus,
                join=join,
                session=session_of(session, join),
                out=out,
                resume=resume,
                verify=verify,
                study=study,
                backend=backend.value,
                benches=benches,
                in_flight=in_flight,
                realtime=realtime,
                controller=controller,
                confirm=confirm,
            )
        )

    return present("tune", job, plain=plain, as_json=as_json, first=f"tune {bench or resume or ''}".strip())


def _bench_of(bench: Path | None, resume: Path | None) -> Path:
    """The bench file that was given, or the copy in the run that is to go on."""
    if bench is not None:
        return bench
    if resume is not None:
        return resume / "bench.toml"
    known = sorted(Path("bench_configs").glob("*.toml"))
    listed = ", ".join(str(path) for path in known) or "bench_configs/NAME.toml"
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
    """Drive a run's winner on the verify model.

    Beside it the manual parameters. Exit status 1 when the winner does not hold.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.tune.verify import verify as start_job

        return start_job(run, bus=bus, bench_bus=bench_bus, join=join, session=session_of(session, join))

    return present("verify", job, plain=plain, as_json=as_json, first=f"verify {run}")


def replay(
    run: RunPath,
    episode: Annotated[int | None, typer.Option(help="which episode; default: all")] = None,
    verify: Annotated[bool, typer.Option("--verify", help="drive it again and compare every frame")] = False,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Read a run's logs again.

    With --verify drive it again and compare every frame: exit status 1 when they differ.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.replay import replay as start_job

        return start_job(run, episode=episode, verify=verify)

    return present("replay", job, plain=plain, as_json=as_json, first=f"replay {run}")
