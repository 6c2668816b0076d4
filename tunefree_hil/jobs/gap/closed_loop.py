"""Closed loop: the drive of a log again, same controller, same road, on the model as it was, recalibrated, repaired.

Only a drive of our own says which controller drove it: a log in a run folder (interfaces 6). What a person or a foreign
program did cannot be done again from a log. Differences are RMS of the simulated drive from the measured one.
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
from tunefree_hil.gap.repair import write_repaired

if TYPE_CHECKING:
    from tunefree_hil.bench import Bench
    from tunefree_hil.config.schema import ScenarioSpec
    from tunefree_hil.episode.recording import Recording
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
VERIFY = "verify"  # folder of a tune's run with the drives on the vehicle
UNKNOWN = "no controller is known that drove this: it is no log of a run folder"


class Sum(NamedTuple):
    """Squares over rows: of a signal itself as it was measured, or of a simulated drive's difference from it."""

    squares: float
    rows: int


Sums = dict[str, dict[str, list[Sum]]]  # by signal and model (or MEASURED), one of each drive


def replayed(
    logs: Sequence[Path], material: Material, mended: Mended
) -> Generator[Event, None, tuple[dict[str, Any] | None, str]]:
    """(`closed_loop` of gap.json, why there is none). down_frac: by how much of itself the tracking's difference from
    the measured drive shrinks, all four errors together; worst_frac: by how much the worst signal grows.
    """
    ours = [log for log in logs if _run_of(log) is not None]
    if mended.model is None or not ours:
        return None, "" if mended.model is None else UNKNOWN
    sums: Sums = {}
    with tempfile.TemporaryDirectory(prefix="tunefree-gap-") as scratch:
        null = write_repaired(Path(scratch) / "recalibrated", material.model, mended.null.model, {})
        models = {"before": material.model.folder, "recalibrated": null.folder, "after": mended.model.folder}
        for log in ours:
            yield Event("note", f"closed loop: {log}")
            try:
                _drive_again(log, models, sums)
            except InputError as error:
                return None, f"{log} cannot be driven again here: {error.message}"
    return compared(sums, len(ours)), ""


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


def _drive_again(log: Path, models: Mapping[str, str], sums: Sums) -> None:
    """One drive on all models; what the bench file did to its own model is left out: the car that was measured had it,
    and it is what is looked for.
    """
    from tunefree_hil.bench import load
    from tunefree_hil.episode.recording import load_recording
    from tunefree_hil.jobs.drive import find_scenario
    from tunefree_hil.jobs.run_folder import open_run, read_json

    run = _run_of(log)
    assert run is not None
    bench = load(open_run(run).bench_file())
    spec = bench.spec
    bare = type(spec)(**{name: getattr(spec, name) for name in spec.__struct_fields__ if name != "effects"})
    said = read_json(log.parent / "episode.json")
    scenario = find_scenario(bench, said["scenario"])
    measured = load_recording(log.parent / "columns.npz")
    for name, model in models.items():
        made = _driven(replace(bench, spec=bare), model, scenario, said)
        for signal in SIGNALS:
            if made.get(signal) is not None and measured.get(signal) is not None:
                sums.setdefault(signal, {}).setdefault(name, []).append(_difference(made, measured, signal))
    for signal, some in sums.items():
        some.setdefault(MEASURED, []).append(_sum_of(measured.get(signal)))


def _driven(bench: Bench, model: str, scenario: ScenarioSpec, said: Mapping[str, Any]) -> Recording:
    from tunefree_hil.bench.simulator import Job, Simulator

    driven = Simulator(bench, model).drive(Job(said["parameters"], scenario, said["seed"]))
    if driven.error:
        raise InputError(f"the drive on {Path(model).name} ends with {driven.error}", code="not_driven")
    return driven.recording


def _difference(made: Recording, measured: Recording, signal: str) -> Sum:
    """Over the rows that both have."""
    one, other = made.get(signal), measured.get(signal)
    assert one is not None and other is not None
    rows = min(len(one), len(other))
    apart = one[:rows] - other[:rows]
    if signal == "heading_error_rad":
        apart = (apart + math.pi) % (2.0 * math.pi) - math.pi
    return _sum_of(apart)


def _sum_of(values: Any) -> Sum:
    import numpy as np

    some = values[np.isfinite(values)] if values is not None else np.zeros(0)
    return Sum(float(some @ some), len(some))


def compared(sums: Mapping[str, Mapping[str, Sequence[Sum]]], drives: int) -> dict[str, Any]:
    """`closed_loop` of gap.json. Errors of different units are put together in units of what they were in the measured
    drives, and squares are summed before they are compared: an error that was next to none before says next to nothing.
    """
    signals = {
        name: {"unit": SIGNALS[name], **{key: _rms(values) for key, values in some.items()}}
        for name, some in sums.items()
    }
    kept = [one for name in TRACKING if (one := signals.get(name)) and one[MEASURED] > 0.0]
    before, after = (sum((one[key] / one[MEASURED]) ** 2 for one in kept) for key in ("before", "after"))
    more = {name: growth for name, one in signals.items() if (growth := _growth(one)) is not None}
    if before <= NO_DIFFERENCE**2 * len(kept) or not more:
        return {"signals": signals, "drives": drives, "down_frac": None, "worst_frac": None, "words": "no difference"}
    down, worst = 1.0 - math.sqrt(after / before), max(more, key=lambda name: more[name])
    words = f"the tracking's difference from the measured drive is {_change(-down)}, {worst}"
    words += f" {'is ' if more[worst] > 0.0 else 'least, '}{_change(more[worst])}"
    return {
        "signals": signals, "drives": drives, "down_frac": down, "worst_frac": more[worst], "worst": worst,
        "words": words,
    }  # fmt: skip


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
