"""What a calibration fits on drives and writes: the channels, then the constants; a model folder with its card.

`calibrate` is made of it, and `learn`, which calibrates where no physics is named.
"""

from __future__ import annotations

import json
import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.jobs.learn.report_text import channel_words, constant_words
from tunefree_hil.jobs.progress import left_s, told
from tunefree_hil.jobs.run_folder import versions
from tunefree_hil.learn.actuators.identify import channels_of, in_motion, sources
from tunefree_hil.learn.actuators.samples import ECHOES, Pairs, has_channel
from tunefree_hil.learn.actuators.samples_from_motion import Law, suggested
from tunefree_hil.learn.compiled_process import Worker
from tunefree_hil.learn.data_sheet import asks_accel, channel_sheet, constants, fixed_params
from tunefree_hil.learn.drives.drive import Drive, Part, Split
from tunefree_hil.learn.drives.smoothing import noise_table_of, valid_region
from tunefree_hil.learn.drives.split import split_drives
from tunefree_hil.learn.drives.validity import those_that_say_all
from tunefree_hil.learn.estimate import ActuatorFit, Value, as_data
from tunefree_hil.learn.evaluation.plot_data import Judged
from tunefree_hil.learn.model_folder import CARD_FILE, write_model
from tunefree_hil.learn.physics.fit import PhysicsFit, is_clear
from tunefree_hil.learn.physics.unknowns import EFFECTS, PLAIN
from tunefree_hil.learn.physics.windows import Off, Windows, windows_of

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec

CARD_SCHEMA = "tunefree.card/1"
OWN_KEYS = {"kind", "logs", "vehicle_hash", "seed", "actuators", "constants", "windows", "free_run_rms"}  # of a card
# A channel that stops before its command does is identified up to its stop (learn/actuators/samples.py)
STOPPED = ("short_of_command",)
LIBRARIES = ("numpy", "scipy", "numba")  # that the numbers come from
WINDOWS_S, ENOUGH_WINDOWS = (8.0, 5.0, 3.0), 12  # lengths of free runs; several logs may be 5 s long each


class Fitted(NamedTuple):
    """What the process beside this one found. traces: by channel, for the figure."""

    actuators: dict[str, ActuatorFit]
    traces: dict[str, list[Any]]
    physics: PhysicsFit
    judged: Judged | None


def split_of(drives: Sequence[Drive], seed: int) -> Generator[Event, None, Split]:
    """What is fitted on and what judges it; where a drive is too short for both, all of it is fitted on. A drive that
    says nothing of a channel of which others do is left out: it would be one at rest.
    """
    drives, lacking = those_that_say_all(drives)
    yield from (Event("warning", words) for words in lacking)
    try:
        split = split_drives(drives, seed=seed)
    except InputError as error:
        if error.code != "too_short":
            raise
        parts = tuple(Part(drive, 0, drive.ticks) for drive in drives)
        split = Split(parts, (), "nothing held out: the logs are too short; errors are those of the fit itself")
        yield Event("warning", split.words)
    yield Event("note", split.words)
    return split


def fit_all(worker: Worker, split: Split, vehicle: VehicleSpec) -> Generator[Event, None, Fitted]:
    """All channels, then the physical constants."""
    actuators: dict[str, ActuatorFit] = {}
    traces: dict[str, list[Any]] = {}
    laws: dict[str, Law] = {}
    for channel in channels_of(vehicle):
        training, held_out, law = sources(split, channel, vehicle)
        laws |= {} if law is None else {channel: law}
        sheet = channel_sheet(vehicle, channel)
        echo = any(part.drive.get(f"report.{ECHOES[channel]}") is not None for part in split.training)
        asked = worker.call("tunefree_hil.learn.actuators.identify", "fit", training, held_out, sheet, echo)
        found = yield from _with_progress(asked, f"actuator {channel}")
        found = in_motion(found, sheet) if law is not None else found
        actuators[channel] = found
        traces[channel] = _traced(worker, held_out if held_out.some else training, found, sheet.rest)
        yield from _said(channel, found, has_channel([part.drive for part in split.training], channel))
    if not laws:
        _refuse_blind(actuators, split.training)
    windows, unseen = windows_in(split, vehicle, actuators)
    seen = suggested(laws, fixed_params(vehicle)["mass_kg"])
    known, fixed = constants(vehicle, seen), fixed_params(vehicle, seen)
    brake_way = max(vehicle.limits.brake_frac - vehicle.nominal.rest_pedal_frac, 0.05)
    asked = worker.call("tunefree_hil.learn.physics.fit", "fit", windows, fixed, known, brake_way)
    physics = yield from _with_progress(asked, "physical constants")
    for words in (*physics.words, *constant_words(physics)):
        yield Event("note", words)
    yield from _untold(physics.values)
    judged = _judged(worker, unseen, physics, fixed | {name: one.value for name, one in known.items()})
    return Fitted(actuators, traces, physics, judged)


def _untold(values: Mapping[str, Value]) -> Iterator[Event]:
    """Constants that these logs do not tell, each with why; in one sentence those that this car does not need."""
    untold = {name: value.why for name, value in values.items() if not value.known}
    if plain := [name for name, why in untold.items() if why == PLAIN]:
        yield Event("note", f"these logs are driven as well without {', '.join(plain)}")
    for name, why in untold.items():
        if why != PLAIN and name not in EFFECTS:
            yield Event("warning", f"{name}: {why}")


def windows_in(split: Split, vehicle: VehicleSpec, channels: dict[str, ActuatorFit]) -> tuple[Windows, Windows]:
    """Windows of the training and the held-out parts: as long as there are enough of them, else shorter."""
    for window_s in WINDOWS_S:
        windows = windows_of(split.training, vehicle, window_s, channels)
        if len(windows.some) >= ENOUGH_WINDOWS:
            break
    return windows, windows_of(split.held_out, vehicle, window_s, channels)


def _with_progress(asked: Generator[tuple[float, float], None, Any], label: str) -> Generator[Event, None, Any]:
    """Steps of a fit as progress; what it returns."""
    began = time.monotonic()

    def event_of(step: tuple[float, float]) -> Event:
        done, total = step
        eta_s = left_s(began, done / total)
        return Event("progress", "", {"label": label, "done": done, "total": total, "eta_s": eta_s})

    return told(asked, event_of)


def _traced(worker: Worker, pairs: Pairs, found: ActuatorFit, rest: float) -> list[Any]:
    return (
        worker.result("tunefree_hil.learn.evaluation.plot_data", "traces", pairs, found.params(rest))
        if pairs.some
        else []
    )


def _said(channel: str, found: ActuatorFit, commanded: bool) -> Iterator[Event]:
    """One line of what was found, and a warning for what was not."""
    yield Event("note", channel_words(channel, found))
    if not commanded:
        yield Event("warning", f"{channel}: no log holds a command of it; {found.words}")
        return
    for name, value in found.numbers().items():
        if not value.known:
            yield Event("warning", f"{channel} {name}: {value.why}")


def _refuse_blind(actuators: dict[str, ActuatorFit], training: Sequence[Any]) -> None:
    """Nothing at all was identified: these are no logs of a by-wire vehicle that somebody drove."""
    if any(found.dead_time_s.known for found in actuators.values()):
        return
    reasons = "; ".join(f"{channel}: {found.words}" for channel, found in actuators.items())
    raise InputError(
        f"not one by-wire channel can be identified: {reasons}",
        code="no_excitation",
        file=training[0].drive.name if training else "",
        key="LOG",
        hint="drive with changing pedals and steering while the by-wire channels are on: `tunefree-hil collect` does",
    )


def _judged(worker: Worker, unseen: Windows, physics: PhysicsFit, before: dict[str, float]) -> Judged | None:
    if not unseen.some:
        return None
    after = physics.params, physics.off()
    return worker.result("tunefree_hil.learn.evaluation.plot_data", "judged", unseen.some, (before, Off()), after)


def card_of(
    drives: Sequence[Drive], split: Split, vehicle: VehicleSpec, fitted: Fitted, seed: int, seconds: float
) -> dict[str, Any]:
    """card.json: what the model is made of and how good it is."""
    judged = fitted.judged
    return {
        "schema": CARD_SCHEMA,
        "kind": "physics",
        "vehicle": vehicle.name,
        "vehicle_hash": f"sha256:{vehicle.hash}",
        "logs": [{"name": one.name, "hash": one.log_hash, "seconds": one.ticks * one.dt_s} for one in drives],
        "seed": seed,
        "split": split.words,
        "versions": versions(LIBRARIES),
        "seconds": round(seconds, 1),
        "actuators": {name: _channel_card(found) for name, found in fitted.actuators.items()},
        "constants": as_data(fitted.physics.values),
        "constants_together": fitted.physics.together,
        "left_out": list(fitted.physics.words),
        "windows": {
            "training": fitted.physics.windows,
            "held_out": judged.windows if judged else 0,
            "seconds": float(judged.time_s[-1]) if judged else None,
        },
        "free_run_rms": {
            "training": {"data_sheet": fitted.physics.before, "fitted": fitted.physics.after},
            "held_out": {"data_sheet": judged.before, "fitted": judged.after} if judged else None,
        },
    }


def said_of(folder: Path) -> dict[str, Any]:
    """The card of a model as `calibrate` made it; empty for every other folder."""
    path = folder / CARD_FILE
    try:
        said = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    except ValueError:
        return {}
    is_own = isinstance(said, dict) and said.keys() >= OWN_KEYS and "repair" not in said
    return said if is_own and said["kind"] == "physics" else {}


def _channel_card(found: ActuatorFit) -> dict[str, Any]:
    more = {"order": found.order, "held_out_rms": found.error, "reports": found.rows, "words": found.words}
    return {**as_data(found.numbers()), **more, "noise": found.noise, "quantum": found.quantum}


def write(out: Path, vehicle: VehicleSpec, fitted: Fitted, split: Split, card: dict[str, Any]) -> None:
    """The model folder, with the map that a controller drives it by."""
    rest = vehicle.nominal.rest_pedal_frac
    params = fitted.physics.params
    write_model(
        out,
        vehicle,
        kind="physics",
        actuators=fitted.actuators,
        params=params,
        valid=valid_region(split.training, rest),
        noise=noise_table_of(split.training),
        card=card,
        calibration=calibration_of(vehicle, fitted),
        effects=[
            effect_of(name, value)
            for name, value in fitted.physics.values.items()
            if name in EFFECTS and is_clear(name, value)
        ],
    )


def calibration_of(vehicle: VehicleSpec, fitted: Fitted) -> dict[str, Any] | None:
    """The arrays of calibration.npz; None for a car that shows no pedals, which there is no map of."""
    from tunefree_hil.learn.open_loop_map.build import as_arrays, open_loop_map
    from tunefree_hil.plant.single_track import PLANT

    if asks_accel(vehicle):
        return None
    rest = vehicle.nominal.rest_pedal_frac
    pedals = {name: fitted.actuators[name].params(rest) for name in ("throttle", "brake")}
    brake = pedals["brake"]
    idle = brake.dead_band + fitted.physics.off().brake_frac / max(brake.gain, 0.1)  # before the report and behind it
    pedals["brake"] = brake._replace(dead_band=idle)
    return as_arrays(open_loop_map(PLANT, fitted.physics.params, vehicle, pedals))


def effect_of(name: str, value: Value) -> dict[str, Any]:
    """The entry of [[effects]] for what lies between a reported output and the car."""
    effect, parameter, _ = EFFECTS[name]
    return {"name": effect, "params": {parameter: value.value}, "interval": {parameter: [value.low, value.high]}}
