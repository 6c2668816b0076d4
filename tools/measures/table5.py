"""Minutes for 2, 6 and 11 parameters with 200, 400 and 800 trials, over the bus and in the batch (paper, Table V)."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from msgspec.structs import replace as with_values

from tools.measures import bus_tune
from tools.measures._ledger import FOLDER, Ledger
from tools.measures._rig import standing
from tools.measures._summary import machine, rounded
from tools.reproduction.searches import SearchBench, SearchSetting
from tunefree_hil.bench import load
from tunefree_hil.config.schema import with_scenarios
from tunefree_hil.jobs.identity import resolved_toml

VALUE = "minutes that 11 parameters with 800 trials take over the bus (extrapolated); detail: 2 and 6, and in the batch"
NAME = "table5"
BENCH = "bench_configs/mkz_complete.toml"
SAMPLER = "tpe_independent"
Say = Callable[[str], None]


class Setup(NamedTuple):
    """A row of Table V. paper_minutes: As printed, least and most."""

    set_name: str
    parameters: int
    trials: int
    paper_minutes: tuple[float, float]


SETUPS = (
    Setup("mrac", 2, 200, (60.0, 120.0)),
    Setup("lateral", 6, 400, (180.0, 240.0)),
    Setup("complete", 11, 800, (360.0, 420.0)),
)
MANUAL_HOURS = 120.0  # paper, Table V: 11 parameters by hand


class Sizes(NamedTuple):
    """What is measured.

    Attributes:
        bus_trials: Measured over the bus, of each setup; 0: all, so nothing is extrapolated.
        batch_share: Of the trials of a setup, in the batch.
        scenarios: Of the bench file; empty: all.
    """

    bus_trials: int = 20
    batch_share: float = 1.0
    scenarios: tuple[str, ...] = ()


class SetupTimes(NamedTuple):
    """Times of one setup. bus_trials: measured; low, high: 95 % interval of the extrapolated minutes."""

    setup: Setup
    bus_minutes: float
    bus_low: float | None
    bus_high: float | None
    bus_trials: int
    bus_seconds_a_trial: float
    batch_minutes: float
    batch_trials: int


def measure(trials: int = 20, seed: int = 1, full: int = 0, bench: str = BENCH, folder: str = FOLDER) -> dict[str, Any]:
    """Time `trials` trials of each setup over the bus and extrapolate; in the batch the whole search. full: 1 for whole
    searches over the bus too (hours). Goes on when called again.
    """
    before = machine()
    sizes = Sizes(bus_trials=0 if full else trials)
    rows = time_setups(bench, Path(folder) / NAME, sizes, seed, lambda text: print(text, file=sys.stderr, flush=True))
    largest = rows[-1]
    detail = {"machine": before, "bench": bench, "rows": [row._asdict() for row in rows]}
    return {
        "value": largest.bus_minutes,
        "unit": "min",
        "n": largest.bus_trials,
        "low": largest.bus_low,
        "high": largest.bus_high,
        "detail": rounded(detail),
    }


def time_setups(bench_file: str, folder: Path, sizes: Sizes, seed: int, say: Say) -> list[SetupTimes]:
    """Every setup, one after the other; those that the folder knows are not timed again."""
    ledger, rows = Ledger(folder), []
    for setup in SETUPS:
        bench = load(bench_file)
        scenarios = [bench.scenarios[name] for name in sizes.scenarios or bench.spec.scenarios]
        depends = {**standing(bench, bench.spec.model, scenarios), **setup._asdict(), **sizes._asdict(), "seed": seed}
        known = ledger.find(depends)
        if known is None:
            say(f"{setup.parameters} parameters, over the bus")
            over_bus = _time_bus(bench_file, folder, setup, sizes)
            say(f"{setup.parameters} parameters, in the batch")
            known = ledger.keep(depends, {**over_bus, **_time_batch(bench_file, folder, setup, sizes, seed)})
        rows.append(SetupTimes(setup=setup, **known))
    return rows


def _time_bus(bench_file: str, folder: Path, setup: Setup, sizes: Sizes) -> dict[str, Any]:
    """Minutes over the bus by `bus_tune`, which drives the first trials as `tune` does and extrapolates."""
    place = folder / setup.set_name
    place.mkdir(parents=True, exist_ok=True)
    file = place / "bench.toml"
    file.write_text(bench_text(bench_file, setup, sizes), encoding="utf-8")
    answer = bus_tune.measure(sizes.bus_trials or setup.trials, setup.trials, 0, str(file), str(place))
    return {
        "bus_minutes": answer["value"],
        "bus_low": answer["low"],
        "bus_high": answer["high"],
        "bus_trials": answer["n"],
        "bus_seconds_a_trial": answer["detail"]["seconds_a_trial"],
    }


def bench_text(bench_file: str, setup: Setup, sizes: Sizes) -> str:
    """The bench file with the set of the setup and only the scenarios that are driven."""
    bench = load(bench_file)
    spec = with_values(bench.spec, tune=with_values(bench.spec.tune, set=setup.set_name, trials=setup.trials))
    if sizes.scenarios:
        spec = with_scenarios(spec, list(sizes.scenarios), [])
    return resolved_toml(replace(bench, spec=spec))


def _time_batch(bench_file: str, folder: Path, setup: Setup, sizes: Sizes, seed: int) -> dict[str, Any]:
    """Minutes of a search in the batch from its beginning, with its sampler; start and compilation are not counted."""
    place = folder / "batch"
    shutil.rmtree(place, ignore_errors=True)  # a search that was cut off tells no time
    trials = max(round(sizes.batch_share * setup.trials), 1)
    with SearchBench(bench_file, place) as bench:
        bench.drive_manual()
        began = time.perf_counter()
        bench.search(SearchSetting(setup.set_name, SAMPLER, trials, seed), lambda done: None)
        minutes = (time.perf_counter() - began) / 60.0
    return {"batch_minutes": minutes, "batch_trials": trials}
