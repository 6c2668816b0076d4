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
from typing import TYPE_CHECKING, Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.gap.repair import write_repaired

if TYPE_CHECKING:
    from tunefree_hil.bench import Bench
    from tunefree_hil.config.schema import ScenarioSpec
    from tunefree_hil.episode.recording import Recording
    from tunefree_hil.jobs.gap import Material
    from tunefree_hil.jobs.gap_repair import Mended

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
UNKNOWN = "no controller is known that drove this: it is no log of a run folder"


def replayed(
    logs: Sequence[Path], material: Material, mended: Mended
) -> Generator[Event, None, tuple[dict[str, Any] | None, str]]:
    """(`closed_loop` of gap.json, why there is none). down_frac: by how much of itself the tracking's difference from
    the measured drive shrinks, all four errors together; worst_frac: by how much the worst signal grows.
    """
    ours = [log for log in logs if _run_of(log) is not None]
    if mended.model is None or not ours:
        return None, "" if mended.model is None else UNKNOWN
    squares: dict[str, dict[str, list[float]]] = {}
    with tempfile.TemporaryDirectory(prefix="tunefree-gap-") as scratch:
        null = write_repaired(Path(scratch) / "recalibrated", material.model, mended.null.model, {})
        models = {"before": material.model.folder, "recalibrated": null.folder, "after": mended.model.folder}
        for log in ours:
            yield Event("note", f"closed loop: {log}")
            try:
                _drive_again(log, models, squares)
            except InputError as error:
                return None, f"{log} cannot be driven again here: {error.message}"
    return _compared(squares, len(ours)), ""


def _run_of(log: Path) -> Path | None:
    """The run folder that a log lies in: RUN/episodes/K/vehicle.log."""
    folder = log.resolve().parent
    run = folder.parent.parent
    here = (folder / "episode.json").is_file() and folder.parent.name == "episodes" and (run / "bench.toml").is_file()
    return run if here else None


def _drive_again(log: Path, models: Mapping[str, str], squares: dict[str, dict[str, list[float]]]) -> None:
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
            difference = _difference(made, measured, signal)
            if difference is not None:
                squares.setdefault(signal, {}).setdefault(name, []).append(difference)


def _driven(bench: Bench, model: str, scenario: ScenarioSpec, said: Mapping[str, Any]) -> Recording:
    from tunefree_hil.bench.simulator import Job, Simulator

    driven = Simulator(bench, model).drive(Job(said["parameters"], scenario, said["seed"]))
    if driven.error:
        raise InputError(f"the drive on {Path(model).name} ends with {driven.error}", code="not_driven")
    return driven.recording


def _difference(made: Recording, measured: Recording, signal: str) -> float | None:
    """Mean square, over the rows that both have."""
    import numpy as np

    one, other = made.get(signal), measured.get(signal)
    if one is None or other is None:
        return None
    rows = min(len(one), len(other))
    apart = one[:rows] - other[:rows]
    if signal == "heading_error_rad":
        apart = (apart + math.pi) % (2.0 * math.pi) - math.pi
    return float(np.nanmean(apart**2))


def _compared(squares: Mapping[str, Mapping[str, Sequence[float]]], drives: int) -> dict[str, Any]:
    signals = {
        name: {"unit": SIGNALS[name], **{key: _rms(values) for key, values in some.items()}}
        for name, some in squares.items()
    }
    left = [(signals[name]["after"] / signals[name]["before"]) ** 2 for name in TRACKING if _moved(signals, name)]
    more = {name: one["after"] / one["before"] - 1.0 for name, one in signals.items() if _moved(signals, name)}
    if not left:
        return {"signals": signals, "drives": drives, "down_frac": None, "worst_frac": None, "words": "no difference"}
    down, worst = 1.0 - math.sqrt(sum(left) / len(left)), max(more, key=lambda name: more[name])
    change = "down" if down >= 0.0 else "up"
    words = f"the tracking's difference from the measured drive is {change} by {100.0 * abs(down):.0f} %"
    words += f", {worst} by {-100.0 * more[worst]:.0f} % least"
    return {
        "signals": signals, "drives": drives, "down_frac": down, "worst_frac": more[worst], "worst": worst,
        "words": words,
    }  # fmt: skip


def _rms(squares: Sequence[float]) -> float:
    return math.sqrt(sum(squares) / len(squares))


def _moved(signals: Mapping[str, Mapping[str, Any]], name: str) -> bool:
    return name in signals and signals[name]["before"] > 0.0
