"""What a calibration says to people.

What `drive` and `tune` say of the model before they drive it: its kind, and of a learned one what its card says.

Beside every result: how much of its drives lies outside the region that the model's data covered.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tunefree_hil.bench import Bench, model_of
from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.episode.recording import Recording
from tunefree_hil.episode.validity_region import Outside, outside, together
from tunefree_hil.gap.selection.baseline_misfit import usual_in, usual_words
from tunefree_hil.jobs.command_text import pasted
from tunefree_hil.learn.estimate import ActuatorFit, Value
from tunefree_hil.learn.physics.fit import PhysicsFit
from tunefree_hil.learn.physics.unknowns import BAND, LAG, OFFSET, ROAD

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec

# name -> (unit, factor)
UNITS = {
    "drive_force_n": ("N", 1.0),
    "drive_knee_frac": ("", 1.0),
    "drive_power_w": ("kW", 1e-3),
    "drive_corner": ("", 1.0),
    "throttle_zero_frac": ("duty", 1.0),
    "creep_force_n": ("N", 1.0),
    "creep_speed_mps": ("m/s", 1.0),
    "overrun_force_n": ("N", 1.0),
    "brake_force_n_per_frac": ("kN per duty", 1e-3),
    "brake_rise_per_frac": ("per duty", 1.0),
    "rolling_frac": ("", 1.0),
    "drag_area_m2": ("m²", 1.0),
    "front_stiffness_n_per_rad": ("kN/rad", 1e-3),
    "rear_stiffness_n_per_rad": ("kN/rad", 1e-3),
    "yaw_inertia_kgm2": ("kg m²", 1.0),
    "steer_ratio": ("", 1.0),
    "linkage_bend": ("per rad²", 1.0),
    OFFSET: ("rad", 1.0),
    BAND: ("duty", 1.0),
    LAG: ("s", 1.0),
    ROAD: ("of what the accelerometer says throughout is a slope, the rest its own", 1.0),
}
SEED = 1  # of --seed
KNOWN, TAKEN = "", "; not from these logs"


def channel_words(channel: str, found: ActuatorFit) -> str:
    """One line about a channel."""
    dead = f"dead time {_ms(found.dead_time_s)}"
    if found.order == 1:
        lag = f"lag {_ms(found.lag_s)}"
    else:
        lag = f"second-order lag, 63 % in {1e3 * found.lag_63_s():.0f} ms"
    rate = found.rate_limit
    limit = f", rate limit {_span(rate, unit=' per s')}" if math.isfinite(rate.value) else ""
    band = f", dead band {_span(found.dead_band)}" if found.dead_band.value > 0.0 else ""
    return f"{channel}: {dead}, {lag}{limit}{band}"


def _ms(value: Value) -> str:
    low, high = 1e3 * value.low, 1e3 * value.high
    return f"{1e3 * value.value:.1f} ms ({low:.1f} to {high:.1f}{KNOWN if value.known else TAKEN})"


def _span(value: Value, factor: float = 1.0, unit: str = "") -> str:
    ends = f"{factor * value.low:.4g} to {factor * value.high:.4g}"
    return f"{factor * value.value:.4g}{unit} ({ends}{KNOWN if value.known else TAKEN})"


def constant_words(physics: PhysicsFit) -> Iterator[str]:
    """A line for each constant that the logs show."""
    for name, value in physics.values.items():
        if value.known:
            unit, factor = UNITS[name]
            yield f"{name}: {_span(value, factor)} {unit}".rstrip()


def again(logs: Sequence[Path], vehicle: str, out: Path, seed: int) -> str:
    """The command that goes on."""
    return pasted("calibrate", *logs, vehicle=vehicle, out=out, seed=None if seed == SEED else seed)


def closing(out: Path, vehicle: VehicleSpec, logs: Sequence[Path], card: Mapping[str, Any]) -> dict[str, Any]:
    """Sentence and next commands of the result, by the model's card."""
    actuators, constants, judged = card["actuators"], card["constants"], card["free_run_rms"]["held_out"]
    seen = sum(found["dead_time_s"]["known"] for found in actuators.values())
    known = sum(value["known"] for value in constants.values())
    sentence = f"{out}: {seen} of {len(actuators)} channels and {known} of {len(constants)} constants from the logs"
    if known and judged is not None and "speed_mps" in judged["fitted"]:
        before, after = judged["data_sheet"], judged["fitted"]
        long_s = card["windows"].get("seconds")  # cards of before do not say it
        runs = f"{card['windows']['held_out']} unseen free runs{f' of {long_s:.0f} s' if long_s else ''}"
        off = f"the speed is off by {after['speed_mps']:.2f} m/s (before {before['speed_mps']:.2f})"
        sentence += f"; on {runs} {off}"
        if "x_m" in after and "y_m" in after:
            was, now = (math.hypot(one["x_m"], one["y_m"]) for one in (before, after))
            sentence += f", the place by {now:.1f} m (before {was:.1f})"
    sentence += "".join(f"; {words}, and what is less `gap` cannot see" for words in usual_words(usual_in(card)))
    following = [pasted("drive", bench, model=out) for bench in benches_of(vehicle)[:1]]
    following += [pasted("learn", *logs, vehicle=vehicle.folder, out=f"{out}_hybrid")]
    return {"sentence": sentence, "next": following}


def benches_of(vehicle: VehicleSpec) -> list[str]:
    """Bench files of this vehicle that lie where benches are looked for."""
    from tunefree_hil.base.errors import InputError
    from tunefree_hil.config.find import available, find
    from tunefree_hil.config.load import load_bench

    found = []
    for name in available("bench"):
        try:
            spec = load_bench(name)
        except InputError:
            continue  # one that cannot be read is nothing to suggest
        if Path(spec.vehicle).name == vehicle.name:
            found.append(str(find("bench", name)))
    return found


AFTER_S = "10"


def model_words(model: ModelSpec) -> str:
    """'model mkz_learned: hybrid, from 29 min of logs; after 10 s of free run 0.6 m off ...'; one line.

    A model without a card, which nobody learned, has its kind only.
    """
    words = f"model {Path(model.folder).name}: {model.plant.kind}"
    path = Path(model.folder) / (model.plant.card or "")
    if not model.plant.card or not path.is_file():
        return words
    try:
        card = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        return f"{words}; its {path.name} cannot be read ({error})"
    if not isinstance(card, dict):
        return f"{words}; its {path.name} holds no table"
    minutes = sum(float(one["seconds"]) for one in card.get("logs") or []) / 60.0
    words += f", learned from {minutes:.0f} min of logs" if minutes else ""
    off_m = off_after(card)
    if off_m is not None:
        words += f"; {off_m:.1f} m off after {AFTER_S} s of free run where it was not trained"
    return words


def off_after(card: Mapping[str, Any]) -> float | None:
    """Mean position error after 10 s of free run on held-out level ground, m; None where the card does not say."""
    found: Any = card.get("free_run")
    for key in (card.get("kind"), "level", AFTER_S, "position_m", "mean"):
        found = found.get(key) if isinstance(found, Mapping) else None
    return float(found) if isinstance(found, int | float) and math.isfinite(found) else None


def outside_data(bench: Bench, model: str, drives: Mapping[str, Recording]) -> dict[str, Any]:
    """Plain data for a result: {"model", "share", "by", "drives"}; share None where the model names no region.

    share: of all ticks; by: the same by quantity of [valid]; drives: the share of each drive that leaves the region.
    """
    valid = model_of(bench, model).valid
    found = {name: outside(recording, valid) for name, recording in drives.items()}
    whole = together(found.values())
    if whole is None:
        return {"model": model, "share": None, "by": {}, "drives": {}}
    left = {name: one.share for name, one in found.items() if one is not None and one.share > 0.0}
    return {"model": model, "share": whole.share, "by": whole.by, "drives": left}


def outside_words(data: Mapping[str, Any]) -> str:
    """'0.0 % of its ticks outside the valid region of hybrid_1 ...'; '' where nothing is known."""
    if data["share"] is None:
        return ""
    by = ", ".join(f"{name} {_percent(share)}" for name, share in data["by"].items())
    where = f" ({by})" if by else ""
    return f"{_percent(data['share'])} of the ticks outside the valid region of model {data['model']}{where}"


def drive_warning(bench: Bench, model: str, name: str, recording: Recording) -> str:
    """The flag on one drive that leaves the region; '' for one that does not."""
    found: Outside | None = outside(recording, model_of(bench, model).valid)
    if found is None or found.share == 0.0:
        return ""
    by = ", ".join(f"{key} {_percent(share)}" for key, share in found.by.items())
    return f"{name}: {_percent(found.share)} of it is outside the region that the model's data covered ({by})"


def _percent(share: float) -> str:
    """'<0.1 %' where it is not quite nothing."""
    return "<0.1 %" if 0.0 < share < 0.0005 else f"{100.0 * share:.1f} %"
