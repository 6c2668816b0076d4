"""The options of the commands whose job has no module of its own for them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from tunefree_hil.jobs.options.option import (
    BENCH,
    VEHICLE,
    Argument,
    BenchBus,
    BenchFile,
    Bus,
    Controller,
    Join,
    Model,
    Option,
    Out,
    Realtime,
    RunPath,
    Seed,
    Session,
    Vehicle,
)

BATCH, BUS = "batch", "bus"
DRIVE_S = 110.0  # default time after which a drive of a collection begins to stop


class DriveOptions(NamedTuple):
    """Options of `drive`. scenario: empty for all of the bench file; session: '' for a new one."""

    bench: BenchFile
    scenario: Annotated[Sequence[str], Option("drive only this scenario; may be repeated")] = ()
    model: Model = None
    bus: Bus = "auto"
    bench_bus: BenchBus = ""
    seed: Seed = None
    realtime: Realtime = False
    join: Join = False
    session: Session = ""
    out: Out = None
    parameters: Annotated[Sequence[str], Option("NAME=VALUE; may be repeated", "--parameter")] = ()
    controller: Controller = ""


class TuneOptions(NamedTuple):
    """The options of `tune`, as given; field names are option names and keys of `options` in run.json.

    None: Not given. A resumed run keeps its value; otherwise that of the bench file or of DEFAULTS.
    bench: None for the copy in the run to resume.
    benches, in_flight: 0 for values that follow from bench file and machine.
    session: '' for a new session.
    """

    bench: Annotated[Path | None, BENCH] = None
    trials: Annotated[int | None, Option("number of trials; default: as in the bench file", minimum=1)] = None
    set_name: Annotated[
        str | None,
        Option("parameters to tune; default: as in the bench file", "--set", choices=("mrac", "lateral", "complete")),
    ] = None
    sampler: Annotated[
        str | None,
        Option(
            "auto, gp_ei, gp_ucb, gp_me, tpe_independent, tpe_relative, cma, tpe_cma, trust_region, nsga, qmc or "
            "random (docs/reference/samplers.md)"
        ),
    ] = None
    seed: Seed = None
    scale: Annotated[
        str | None, Option("scale of the search, default: log; the paper uses linear", choices=("log", "linear"))
    ] = None
    bus: Bus = "auto"
    bench_bus: BenchBus = ""
    join: Join = False
    session: Session = ""
    out: Out = None
    resume: Annotated[Path | None, Option("continue the run in this folder, even a finished one")] = None
    verify: Annotated[bool | None, Option("verify the winner on the verify model at the end; default: yes")] = None
    study: Annotated[
        str | None, Option("work on a shared study: postgresql://USER@HOST/DATABASE#STUDY", metavar="URL")
    ] = None
    backend: Annotated[
        str | None,
        Option(
            "batch: compiled; the best trials are confirmed over the bus; default: as in the bench file",
            choices=(BUS, BATCH),
        ),
    ] = None
    benches: Annotated[int, Option("benches side by side; 0: one per core, at most two", minimum=0)] = 0
    in_flight: Annotated[int, Option("trials in a generation; 0: as in the bench file", minimum=0)] = 0
    realtime: Realtime = False
    controller: Controller = ""
    confirm: Annotated[
        int | None, Option("trials of a batch to confirm over the bus; default: 3", metavar="K", minimum=1)
    ] = None
    objectives: Annotated[
        str | None,
        Option(
            "tracking,comfort: search both, the best trade wins; score: their weighted sum; default: as in the bench "
            "file",
            choices=("score", "tracking,comfort"),
        ),
    ] = None


class VerifyOptions(NamedTuple):
    """The options of `verify`. session: '' for a new session."""

    run: RunPath
    bus: Bus = "auto"
    bench_bus: BenchBus = ""
    join: Join = False
    session: Session = ""


class ReplayOptions(NamedTuple):
    """The options of `replay`. verify: drive the episodes again."""

    run: RunPath
    episode: Annotated[int | None, Option("number of the episode; default: all")] = None
    verify: Annotated[bool, Option("drive the run again and compare every frame")] = False


class CollectOptions(NamedTuple):
    """Options of `collect`. out: run folder of this collection, None for a new one under runs/."""

    bench: Annotated[Path | None, Argument("bench file; its verify model is driven")] = None
    vehicle: Vehicle = None
    model: Model = None
    bus: Bus = "auto"
    bench_bus: BenchBus = ""
    session: Session = ""
    out: Annotated[Path | None, Option("folder of this collection; an unfinished one is resumed")] = None
    quota_s: Annotated[float, Option("seconds wanted in each cell")] = 10.0
    area_m: Annotated[float, Option("side of the square area around the start")] = 400.0
    top_mps: Annotated[float | None, Option("top speed; faster cells are left out")] = None
    drive_s: Annotated[float, Option("time after which a drive (a log) stops")] = DRIVE_S
    seed: Annotated[int, Option("seed of the simulated sensor noise", minimum=0)] = 1
    realtime: Realtime = False


class GradeOptions(NamedTuple):
    """Options of `grade`; None: as the log's run, or the default.

    path: reference, a scenario or a CSV. start_s: start of the reference, in seconds from the first frame.
    """

    path: Annotated[
        str | None,
        Option("reference: a scenario, or a CSV with x_m, y_m, speed_mps (and t_s); our logs have theirs"),
    ] = None
    vehicle: Vehicle = None
    align: Annotated[
        Literal["auto", "recorded", "start"], Option("path as recorded, or moved to the pose at the start")
    ] = "auto"
    start_s: Annotated[float | None, Option("start of the reference, seconds into the log")] = None
    weights: Annotated[str | None, Option("weights of the score; default: those of the run, or `default`")] = None
    out: Out = None


class CompareOptions(NamedTuple):
    """Options of `compare`. fail_if: conditions (grade/checks.py)."""

    runs: Annotated[
        Sequence[str], Argument("run folders; RUN:NAME: a baseline of a tune or verify", metavar="RUN RUN ...")
    ]
    fail_if: Annotated[
        Sequence[str], Option("METRIC [@SCENARIO] OP VALUE, such as 'lateral_err_peak > +5%'; may be repeated")
    ] = ()
    weights: Annotated[str | None, Option("weights of the score; default: those of the first run")] = None
    out: Out = None


class ExplainOptions(NamedTuple):
    """Options of `explain`. run: of a finished tune."""

    run: RunPath
    points: Annotated[int, Option("points of each slice through the winner", minimum=3, maximum=101)] = 9
    slices: Annotated[bool, Option("drive slices through the winner", "--slices/--no-slices")] = True


class ExportOptions(NamedTuple):
    """Options of `export`. source: run of a tune, or a bench file; set_name: None for the winner, or its own values."""

    source: Annotated[Path, Argument("run folder of a tune, or a bench file", metavar="RUN|BENCH")]
    target: Annotated[str, Option("the stack to write for", "--to", choices=("apollo", "autoware"))]
    out: Annotated[Path, Option("folder to write; it must be new or empty")]
    set_name: Annotated[str | None, Option("a manual set, or 'tuned', instead of the default", "--set")] = None


class CommissionOptions(NamedTuple):
    """The options of `commission`.

    bench: None for the first bench file of the vehicle.
    only, start_at: A stage to restart, alone or with all that follow.
    least_covered: Smallest share of full cells of the collection.
    most_error_m: Largest error of the learned plant after 10 s of free run, m.
    most_outside: Largest share of the winner's ticks outside the region that the logs cover.
    """

    vehicle: Annotated[str, Argument(VEHICLE.help)]
    bench: Annotated[Path | None, Option("bench file with the scenarios; its verify model is the vehicle")] = None
    out: Annotated[Path | None, Option("folder of this commission; an unfinished one is resumed")] = None
    set_name: Annotated[str | None, Option("mrac, lateral or complete", "--set")] = None
    trials: Annotated[int | None, Option("number of trials of the search", minimum=1)] = None
    kind: Annotated[str, Option("kind of the learned plant")] = "hybrid"
    quota_s: Annotated[float, Option("seconds wanted in each cell of the collection")] = 10.0
    area_m: Annotated[float, Option("side of the square area of the collection")] = 400.0
    minutes: Annotated[float | None, Option("minutes of training")] = None
    seed: Annotated[int, Option("seed of noise, split and nets", minimum=0)] = 1
    bus: Bus = "auto"
    bench_bus: BenchBus = ""
    backend: Annotated[str, Option("what drives the trials: batch or bus")] = BATCH
    top_mps: Annotated[float | None, Option("top speed of the collection")] = None
    only: Annotated[str, Option("restart this stage alone: collect, calibrate, learn, map, tune or verify")] = ""
    start_at: Annotated[str, Option("restart this stage and all that follow", "--from", "STAGE")] = ""
    least_covered: Annotated[float, Option("stop below this share of full cells")] = 0.8
    most_error_m: Annotated[float, Option("stop above this error after 10 s of free run")] = 15.0
    most_outside: Annotated[float, Option("stop above this share outside the valid region")] = 0.25


class ScenariosOptions(NamedTuple):
    """The options of `scenarios`. `seed` and `out` are for `roads`."""

    name: Annotated[str | None, Argument("show this scenario in full")] = None
    vehicle: Vehicle = None
    export: Annotated[Path | None, Option("write each reference trajectory as CSV into this folder")] = None
    roads: Annotated[str | None, Option("make a set of roads instead: families:20, public229, ...")] = None
    seed: Annotated[int, Option("with --roads: draws the roads", minimum=0)] = 1
    out: Annotated[Path | None, Option("with --roads: write them and a figure into this folder")] = None


class DoctorOptions(NamedTuple):
    """The options of `doctor`. Without vehicle, bench and schema the machine is checked, with its `bus`."""

    vehicle: Annotated[Path | None, Option("check a vehicle folder; lists all errors")] = None
    schema: Annotated[str | None, Option("print the JSON Schema of a file: vehicle, bench, ...")] = None
    bus: Bus = "auto"
    bench: Annotated[Path | None, Option("check a bench file and all files that it names")] = None
