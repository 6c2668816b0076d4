"""What a calibration says to people."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tunefree_hil.gap.usual import usual_in, usual_words
from tunefree_hil.jobs.pasted import pasted
from tunefree_hil.learn.physics import PhysicsFit
from tunefree_hil.learn.physics_problem import BAND, LAG, OFFSET, ROAD
from tunefree_hil.learn.values import ActuatorFit, Value

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
