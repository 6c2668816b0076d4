"""Table III: options of the parameter optimiser, and seconds for each iteration."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tools.reproduction import table5
from tools.reproduction.context import STEER_BENCH, Context
from tools.reproduction.fig8 import SEARCHES, SET, search_for
from tools.reproduction.records import Claim, Method, Record, Value
from tools.reproduction.searches import IN_FLIGHT, SearchBench
from tunefree_hil.tune.sampling import ScoredPoint, suggest_point
from tunefree_hil.tune.sampling.records import RECORDS, SamplerRecord, Surrogate, is_installed
from tunefree_hil.tune.space import Space

NAME = "table3"
PAPER_SECONDS = {Surrogate.GPR: "about 120 s (sequential)", Surrogate.TPE: "about 30 s (parallel)"}
TRIALS = 100  # a search of this many, over which the time of the sampler is averaged
READINGS = 3  # of each suggestion; the median counts
PLACES = (0.1, 0.5, 1.0)  # of the search, where the sampler is timed
REPEATED_DRIVES = 3  # generations in the batch


class SamplerTime(NamedTuple):
    """A sampler and what it needs for one suggestion, on average over a search."""

    record: SamplerRecord
    suggestion_s: float


def reproduce(context: Context) -> Record:
    """Time the samplers, and a trial over the bus and in the batch."""
    trials = context.size(TRIALS, 12)
    history = [ScoredPoint(trial.parameters, trial.score) for trial in search_for(context).results[-1].trials]
    with SearchBench(STEER_BENCH, context.folders.work / SEARCHES) as bench:
        space = bench.space(SET)
        batch_s = time_batch_trial(bench)
    times = []
    for record in RECORDS:
        if is_installed(record):
            context.progress.update(0.3 + 0.5 * len(times) / len(RECORDS), f"sampler {record.name}")
            times.append(SamplerTime(record, time_sampler(record.name, space, history, trials)))
    bus_s = table5.time_setups(context)[0].bus_seconds_a_trial
    return Record(
        name=NAME,
        title="Options of the optimiser and time of an iteration",
        paper="Table III: GPR with UCB, EI or ME, sequential, about 120 s an iteration; TPE with EI, sequential or "
        "parallel, about 30 s, over 7 scenarios on a cluster of 130 processors.",
        claim=Claim(
            "All options of the table are there: GPR with UCB, EI and ME; TPE with EI, independent and relative.",
            has_all_options(times),
        ),
        values=(
            Value("driving of a trial over the bus, 2 parameters", bus_s, "s"),
            Value("driving of a trial in the batch", batch_s, "s"),
            *(_value(entry, bus_s, batch_s) for entry in times),
        ),
        method=Method(
            f"{STEER_BENCH}, seven scenarios",
            f"{READINGS} readings at {len(PLACES)} lengths of the history",
            f"search {context.seed}",
            f"Seconds a suggestion, averaged over a search of {trials} trials, plus those of driving: over the bus as "
            f"in Table V, in the batch {IN_FLIGHT} trials at a time on all cores.",
        ),
        difference="The paper's seconds contain its whole driving stack on a cluster, ours a bench on two cores, so "
        "only the order of the options compares.",
        detail={entry.record.name: entry.suggestion_s for entry in times},
    )


def _value(entry: SamplerTime, bus_s: float, batch_s: float) -> Value:
    record, sampler_s = entry.record, entry.suggestion_s
    label = f"{record.name}: {record.surrogate}, {record.acquisition}, {record.drawing}"
    text = (
        f"{bus_s + sampler_s:.3g} s over the bus, {batch_s + sampler_s:.3g} s in the batch (sampler {sampler_s:.2g} s)"
    )
    return Value(label, text, paper=PAPER_SECONDS.get(record.surrogate, "not in the table"))


def has_all_options(times: Sequence[SamplerTime]) -> bool:
    """Whether the samplers cover Table III."""
    have = {(str(entry.record.surrogate), str(entry.record.acquisition)) for entry in times}
    drawings = {str(entry.record.drawing) for entry in times if entry.record.surrogate is Surrogate.TPE}
    wanted = {("GPR", "UCB"), ("GPR", "EI"), ("GPR", "ME"), ("TPE", "EI")}
    return wanted <= have and {"independent", "relative"} <= drawings


def time_sampler(name: str, space: Space, history: Sequence[ScoredPoint], trials: int) -> float:
    """Seconds of a suggestion, the mean over the lengths of the history of their medians."""
    suggest_point(space, history[: max(trials // 2, 1)], sampler=name, seed=0, slot=trials // 2)  # imports
    medians = []
    for place in PLACES:
        known = [history[i % len(history)] for i in range(round(place * trials))]
        readings = []
        for reading in range(READINGS):
            began = time.perf_counter()
            suggest_point(space, known, sampler=name, seed=reading, slot=len(known))
            readings.append(time.perf_counter() - began)
        medians.append(float(np.median(readings)))
    return float(np.mean(medians))


def time_batch_trial(bench: SearchBench) -> float:
    """Seconds of driving a trial in the batch, in generations."""
    bench.drive_manual()  # compiles
    began = time.perf_counter()
    for _ in range(REPEATED_DRIVES):
        bench.drive_manual(IN_FLIGHT)
    return (time.perf_counter() - began) / (REPEATED_DRIVES * IN_FLIGHT)
