"""Closed loop: the drive of a log again, same controller, same road, on the model as it was, recalibrated, repaired.

Only a drive of our own says which controller drove it: a log in a run folder (interfaces 6). What a person or a foreign
program did cannot be done again from a log. Differences are RMS of the simulated drive from the measured one, over the
rows that it and the drives on all models have. A drive that ends early on one is an outcome, and told.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Generator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.gap.validation.repair import write_repaired
from tunefree_hil.jobs.gap.report_text import listed

if TYPE_CHECKING:
    from tunefree_hil.bench.simulator import Drive
    from tunefree_hil.jobs.gap.gap import Material
    from tunefree_hil.jobs.gap.repair import Mended

SIGNALS = {  # columns of a recording (interfaces 6) that say how it tracked, with their units
    "lateral_error_m": "m",
    "heading_error_rad": "rad",
    "station_error_m": "m",
    "speed_error_mps": "m/s",
    "out_steer_rad": "rad",
    "speed_mps": "m/s",
    "yaw_rate_radps": "rad/s",
}
TRACKING = tuple(SIGNALS)[:4]
NO_DIFFERENCE = 1e-3  # of what a signal was in the measured drive: less is none
MEASURED = "measured"
ON = {
    MEASURED: "as it was measured",
    "before": "on the model as it was",
    "recalibrated": "with recalibration only",
    "after": "on the repaired model",
}
DRIVE = "drive"  # the worst of all, beside the signals: a drive that fails
LEAST_S = 1.0  # what ends sooner on every model was not driven, unless it is the car that failed
VERIFY = "verify"  # folder of a tune's run with the drives on the vehicle
UNKNOWN = "no controller is known that drove this: it is no log of a run folder"


class Sum(NamedTuple):
    """Squares over rows: of a signal itself as it was measured, or of a simulated drive's difference from it."""

    squares: float
    rows: int


class End(NamedTuple):
    """How far a drive came. error: the name of what ended it early, '' for none."""

    log: str
    ticks: int
    dt_s: float
    error: str = ""


Sums = dict[str, dict[str, list[Sum]]]  # by signal and model (or MEASURED), one of each drive
Ends = Mapping[str, End]  # of one log, by model (or MEASURED)


def replayed(
    logs: Sequence[Path], material: Material, mended: Mended
) -> Generator[Event, None, tuple[dict[str, Any] | None, str]]:
    """(`closed_loop` of gap.json, why there is none). down_frac: by how much of itself the tracking's difference from
    the measured drive shrinks, all four errors together; worst_frac: by how much the worst signal grows, or failing.
    """
    ours = [log for log in logs if _run_of(log) is not None]
    if mended.model is None or not ours:
        return None, "" if mended.model is None else UNKNOWN
    sums: Sums = {}
    ends: list[Ends] = []
    with tempfile.TemporaryDirectory(prefix="tunefree-gap-") as scratch:
        null = write_repaired(Path(scratch) / "recalibrated", material.model, mended.null.model, {})
        models = {"before": material.model.folder, "recalibrated": null.folder, "after": mended.model.folder}
        for log in ours:
            yield Event("note", f"closed loop: {log}")
            try:
                drives = _driven_again(log, models)
            except InputError as error:
                return None, f"{log} cannot be driven again here: {error.message}"
            _add(sums, drives)
            ends.append({key: End(str(log), one.ticks, one.recording.dt_s, one.error) for key, one in drives.items()})
    found = compared(sums, len(ours), ends)
    if _failing(ends) > 0.0:
        yield Event("warning", f"closed loop: {found['words']}")
    return found, ""


def _run_of(log: Path) -> Path | None:
    """The run folder that a log lies in: RUN/episodes/K/vehicle.log, or RUN/verify/episodes/K/vehicle.log of a tune,
    whose bench file both were driven by.
    """
    folder = log.resolve().parent
    if folder.parent.name != "episodes" or not (folder / "episode.json").is_file():
        return None
    run = folder.parent.parent
    run = run.parent if run.name == VERIFY and not (run / "run.json").is_file() else run
    return run if (run / "run.json").is_file() and (run / "bench.toml").is_file() else None


def _driven_again(log: Path, models: Mapping[str, str]) -> dict[str, Drive]:
    """The measured drive, and the same on all models; what the bench file did to its own model is left out: the car
    that was measured had it, and it is what is looked for. Raises InputError for what cannot be driven at all.
    """
    from tunefree_hil.bench import load
    from tunefree_hil.bench.simulator import Drive, Job, Simulator
    from tunefree_hil.episode.recording import load_recording
    from tunefree_hil.grade.score import DIVERGED, LEFT_LANE
    from tunefree_hil.jobs.drive import find_scenario
    from tunefree_hil.jobs.run_folder import JOINED, open_run, read_json
    from tunefree_hil.jobs.tune.margins import why_not

    folder = _run_of(log)
    assert folder is not None
    run = open_run(folder)
    bench = load(run.bench_file())
    if reason := why_not(bench, run.record.get(JOINED)):
        raise InputError(reason, code="not_in_batch")
    spec = bench.spec
    bare = type(spec)(**{name: getattr(spec, name) for name in spec.__struct_fields__ if name != "effects"})
    said = read_json(log.parent / "episode.json")
    job = Job(said["parameters"], find_scenario(bench, said["scenario"]), said["seed"])
    measured = load_recording(log.parent / "columns.npz")
    made = {name: Simulator(replace(bench, spec=bare), model).drive(job) for name, model in models.items()}
    car_failed = ("", LEFT_LANE, DIVERGED)
    if all(one.error not in car_failed and one.ticks * bench.dt_s < LEAST_S for one in made.values()):
        how = listed(sorted({one.error for one in made.values()}))
        raise InputError(f"no model is driven for {LEAST_S:g} s, it ends with {how}", code="not_driven")
    error = said["error"].split(" ")[0]  # without the number of a controller's own
    return {MEASURED: Drive(measured, measured.ticks, error), **made}


def _add(sums: Sums, drives: Mapping[str, Drive]) -> None:
    """The signals of one log, over the rows that all its drives have: one that ends early is not flattered by it."""
    import numpy as np

    from tunefree_hil.learn.evaluation.motion import wrapped

    rows = min(one.recording.ticks for one in drives.values())
    for signal in SIGNALS:
        had = {key: one.recording.get(signal) for key, one in drives.items()}
        some = {key: values[:rows] for key, values in had.items() if values is not None}
        if len(some) < len(had):
            continue
        told = np.logical_and.reduce([np.isfinite(values) for values in some.values()])
        if not told.any():
            continue
        measured = some.pop(MEASURED)
        apart = {key: values - measured for key, values in some.items()}
        if signal == "heading_error_rad":
            apart = {key: wrapped(values) for key, values in apart.items()}
        for key, values in {MEASURED: measured, **apart}.items():
            sums.setdefault(signal, {}).setdefault(key, []).append(_sum_of(values[told]))


def _sum_of(values: Any) -> Sum:
    return Sum(float(values @ values), len(values))


def compared(sums: Mapping[str, Mapping[str, Sequence[Sum]]], drives: int, ends: Sequence[Ends] = ()) -> dict[str, Any]:
    """`closed_loop` of gap.json. Errors of different units are put together in units of what they were in the measured
    drives, and squares are summed before they are compared: an error that was next to none before says next to nothing.
    """
    signals = {
        name: {"unit": SIGNALS[name], **{key: _rms(values) for key, values in some.items()}}
        for name, some in sums.items()
    }
    found: dict[str, Any] = {"signals": signals, "drives": drives, "ended": _ended(ends)}
    kept = [one for name in TRACKING if (one := signals.get(name)) and one[MEASURED] > 0.0]
    before, after = (sum((one[key] / one[MEASURED]) ** 2 for one in kept) for key in ("before", "after"))
    more = {name: growth for name, one in signals.items() if (growth := _growth(one)) is not None}
    none, fails = before <= NO_DIFFERENCE**2 * len(kept), _failing(ends)
    if fails > 0.0:
        more[DRIVE] = fails
    if not more or (none and DRIVE not in more):
        return {**found, "down_frac": None, "worst_frac": None, "words": "no difference" + _early(found["ended"], ends)}
    down, worst = None if none else 1.0 - math.sqrt(after / before), max(more, key=lambda name: more[name])
    words = "the tracking's difference from the measured drive "
    words += "was none in what all have" if down is None else f"is {_change(-down)}"
    if DRIVE in more:
        words += ", and the repaired model fails where the measured car did not"
    if worst != DRIVE:
        words += f", {worst} {'is ' if more[worst] > 0.0 else 'least, '}{_change(more[worst])}"
    words += _early(found["ended"], ends)
    return {**found, "down_frac": down, "worst_frac": more[worst], "worst": worst, "words": words}


def _ended(ends: Sequence[Ends]) -> dict[str, list[dict[str, Any]]]:
    """What ended early, by model (or MEASURED), and how; only those of which a drive did."""
    found = {
        key: [
            {"log": one.log, "how": one.error, "t_s": round(one.ticks * one.dt_s, 6)}
            for one in (each[key] for each in ends)
            if one.error
        ]
        for key in ON
    }
    return {key: some for key, some in found.items() if some}


def _early(ended: Mapping[str, Sequence[Mapping[str, Any]]], ends: Sequence[Ends]) -> str:
    """The same in words, and of how much of the measured drives all this is told."""
    told = []
    for key, some in ended.items():
        first = min(some, key=lambda one: one["t_s"])
        count = f"{len(some)} of {len(ends)} drives, first " if len(ends) > 1 else ""
        told.append(f"{ON[key]} ({count}{first['how']} after {first['t_s']:.4g} s)")
    if not told:
        return ""
    had = sum(min(one.ticks for one in each.values()) for each in ends)
    share = had / max(sum(each[MEASURED].ticks for each in ends), 1)
    only = f"; compared is what all have, {100.0 * share:.0f} % of the measured rows" if share < 1.0 else ""
    return f"; the drive ends early {listed(told)}{only}"


def _failing(ends: Sequence[Ends]) -> float:
    """By how much more a drive fails on the repaired model than on the one before, of the log in which it does most."""
    failed = [{key: _failed(each[key], each[MEASURED]) for key in ("before", "after")} for each in ends]
    return max((_growth({MEASURED: 1.0, **one}) or 0.0 for one in failed), default=0.0)


def _failed(one: End, measured: End) -> float:
    """0.0 where it came to its end, as far as the measured drive that ended early too, or ended as that did; else 1.0
    and the share of the measured drive that it lacks.
    """
    lacks = max(0.0, 1.0 - one.ticks / max(measured.ticks, 1))
    if one.error in ("", measured.error) or (measured.error and lacks == 0.0):
        return 0.0
    return 1.0 + lacks


def _growth(one: Mapping[str, Any]) -> float | None:
    """By how much of itself a signal's difference grows; None where there is none before and after."""
    least = NO_DIFFERENCE * one[MEASURED]
    if max(one["before"], one["after"]) <= least or one["before"] == least == 0.0:
        return None
    return one["after"] / max(one["before"], least) - 1.0


def _change(growth: float) -> str:
    return f"{'up' if growth > 0.0 else 'down'} by {100.0 * abs(growth):.0f} %"


def _rms(some: Sequence[Sum]) -> float:
    return math.sqrt(sum(one.squares for one in some) / max(sum(one.rows for one in some), 1))
