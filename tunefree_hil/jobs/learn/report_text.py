"""Texts about models: results of a calibration, the model of a drive or tune, and drives outside its valid region."""

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
from tunefree_hil.gap.result_text import baseline_texts
from tunefree_hil.gap.selection.baseline_misfit import baseline_from_card
from tunefree_hil.jobs.command_text import shell_command
from tunefree_hil.learn.estimate import ActuatorFit, Estimate
from tunefree_hil.learn.physics.fit import PhysicsFit
from tunefree_hil.learn.physics.unknowns import BRAKE_DEAD_BAND, POWERTRAIN_LAG, ROAD_SHARE, STEER_OFFSET

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec

# Fitted constant -> (unit, factor to it)
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
    STEER_OFFSET: ("rad", 1.0),
    BRAKE_DEAD_BAND: ("duty", 1.0),
    POWERTRAIN_LAG: ("s", 1.0),
    ROAD_SHARE: ("of the constant part of the measured acceleration is road slope, the rest sensor bias", 1.0),
}
IDENTIFIED, FROM_DATA_SHEET = "", "; not from these logs"


def describe_channel(fit: ActuatorFit) -> str:
    """The parameters of a channel in one line."""
    dead = f"dead time {_format_ms(fit.dead_time_s)}"
    if fit.order == 1:
        lag = f"lag {_format_ms(fit.lag_s)}"
    else:
        lag = f"second-order lag, 63 % in {1e3 * fit.lag_63_s():.0f} ms"
    rate = fit.rate_limit
    limit = f", rate limit {_format_span(rate, unit=' per s')}" if math.isfinite(rate.value) else ""
    band = f", dead band {_format_span(fit.dead_band)}" if fit.dead_band.value > 0.0 else ""
    return f"{dead}, {lag}{limit}{band}"


def _format_ms(value: Estimate) -> str:
    low, high = 1e3 * value.low, 1e3 * value.high
    return f"{1e3 * value.value:.1f} ms ({low:.1f} to {high:.1f}{IDENTIFIED if value.known else FROM_DATA_SHEET})"


def _format_span(value: Estimate, factor: float = 1.0, unit: str = "") -> str:
    ends = f"{factor * value.low:.4g} to {factor * value.high:.4g}"
    return f"{factor * value.value:.4g}{unit} ({ends}{IDENTIFIED if value.known else FROM_DATA_SHEET})"


def describe_constants(physics: PhysicsFit) -> Iterator[str]:
    """A line for each constant that the logs identify."""
    for name, value in physics.estimates.items():
        if value.known:
            unit, factor = UNITS[name]
            yield f"{name}: {_format_span(value, factor)} {unit}".rstrip()


def summarise_calibration(
    out: Path, vehicle: VehicleSpec, logs: Sequence[Path], card: Mapping[str, Any]
) -> dict[str, Any]:
    """Sentence and next commands of a result, from the model's card."""
    actuators, constants, held_out = card["actuators"], card["constants"], card["free_run_rms"]["held_out"]
    n_channels = sum(channel["dead_time_s"]["known"] for channel in actuators.values())
    n_constants = sum(value["known"] for value in constants.values())
    identified = f"{n_channels} of {len(actuators)} channels and {n_constants} of {len(constants)} constants"
    sentence = f"{out}: {identified} from the logs"
    if n_constants and held_out is not None and "speed_mps" in held_out["fitted"]:
        before, after = held_out["data_sheet"], held_out["fitted"]
        length_s = card["windows"].get("seconds")  # absent in cards of older versions
        runs = f"{card['windows']['held_out']} held-out free runs{f' of {length_s:.0f} s' if length_s else ''}"
        error = f"the speed error is {after['speed_mps']:.2f} m/s (before {before['speed_mps']:.2f})"
        sentence += f"; on {runs} {error}"
        if "x_m" in after and "y_m" in after:
            old_m, new_m = (math.hypot(rms["x_m"], rms["y_m"]) for rms in (before, after))
            sentence += f", the position error {new_m:.1f} m (before {old_m:.1f})"
    sentence += "".join(
        f"; {words}, and what is less `gap` cannot see" for words in baseline_texts(baseline_from_card(card))
    )
    following = [shell_command("drive", bench, model=out) for bench in find_benches(vehicle)[:1]]
    following += [shell_command("learn", *logs, vehicle=vehicle.folder, out=f"{out}_hybrid")]
    return {"sentence": sentence, "next": following}


def find_benches(vehicle: VehicleSpec) -> list[str]:
    """Bench files of this vehicle in the standard places."""
    from tunefree_hil.base.errors import InputError
    from tunefree_hil.config.find import available, find
    from tunefree_hil.config.load import load_bench

    benches = []
    for name in available("bench"):
        try:
            spec = load_bench(name)
        except InputError:
            continue  # an unreadable bench file is not suggested
        if Path(spec.vehicle).name == vehicle.name:
            benches.append(str(find("bench", name)))
    return benches


FREE_RUN_S = "10"


def describe_model(model: ModelSpec) -> str:
    """'model mkz_learned: hybrid, learned from 29 min of logs; 0.6 m off after 10 s of free run ...'.

    Of a model without a card only the kind is known.
    """
    text = f"model {Path(model.folder).name}: {model.plant.kind}"
    path = Path(model.folder) / (model.plant.card or "")
    if not model.plant.card or not path.is_file():
        return text
    try:
        card = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        return f"{text}; its {path.name} cannot be read ({error})"
    if not isinstance(card, dict):
        return f"{text}; its {path.name} holds no object"
    minutes = sum(float(log["seconds"]) for log in card.get("logs") or []) / 60.0
    text += f", learned from {minutes:.0f} min of logs" if minutes else ""
    error_m = position_error(card)
    if error_m is not None:
        text += f"; {error_m:.1f} m off after {FREE_RUN_S} s of free run on held-out data"
    return text


def position_error(card: Mapping[str, Any]) -> float | None:
    """Mean position error after 10 s of free run on held-out level ground, m; None where the card has none."""
    entry: Any = card.get("free_run")
    for key in (card.get("kind"), "level", FREE_RUN_S, "position_m", "mean"):
        entry = entry.get(key) if isinstance(entry, Mapping) else None
    return float(entry) if isinstance(entry, int | float) and math.isfinite(entry) else None


def measure_outside(bench: Bench, model: str, drives: Mapping[str, Recording]) -> dict[str, Any]:
    """How much of the drives lies outside the model's valid region, as plain data.

    Returns:
        `share` of all ticks (None where the model names no region), `by` quantity of [valid], and `drives`: the share
        of each drive that leaves the region.
    """
    valid = model_of(bench, model).valid
    shares = {name: outside(recording, valid) for name, recording in drives.items()}
    total = together(shares.values())
    if total is None:
        return {"model": model, "share": None, "by": {}, "drives": {}}
    outside_drives = {
        name: result.share for name, result in shares.items() if result is not None and result.share > 0.0
    }
    return {"model": model, "share": total.share, "by": total.by, "drives": outside_drives}


def describe_outside(data: Mapping[str, Any]) -> str:
    """'0.0 % of the ticks outside the valid region of model hybrid_1 ...'; '' where the model names no region."""
    if data["share"] is None:
        return ""
    quantities = ", ".join(f"{name} {_format_percent(share)}" for name, share in data["by"].items())
    details = f" ({quantities})" if quantities else ""
    return f"{_format_percent(data['share'])} of the ticks outside the valid region of model {data['model']}{details}"


def warn_of_outside(bench: Bench, model: str, name: str, recording: Recording) -> str:
    """Warning for a drive that leaves the region; '' for any other drive."""
    result: Outside | None = outside(recording, model_of(bench, model).valid)
    if result is None or result.share == 0.0:
        return ""
    quantities = ", ".join(f"{key} {_format_percent(share)}" for key, share in result.by.items())
    return f"{name}: {_format_percent(result.share)} of it is outside the valid region of the model ({quantities})"


def _format_percent(share: float) -> str:
    """'<0.1 %' for a small share that is not zero."""
    return "<0.1 %" if 0.0 < share < 0.0005 else f"{100.0 * share:.1f} %"
