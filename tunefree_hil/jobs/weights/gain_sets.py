"""Sets of gains of varied quality, and drivers, that drive the pairs."""

from __future__ import annotations

from collections.abc import Mapping
from random import Random

from tunefree_hil.base.contracts import Tunable
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, parameters_of
from tunefree_hil.bench.controller import constants_of, settings_of
from tunefree_hil.bench.identified import identified_of
from tunefree_hil.control.build import PEDAL_PREVIEW, STEER_PREVIEW
from tunefree_hil.control.filters import butterworth_delay_s
from tunefree_hil.control.parameters import SETS, BoxChoice, round32, tunable_in_box
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors, has_foreign_controller, select_first_vector

STEERING = ("lqr.q1", "lqr.q2", "lqr.q3", "lqr.q4")
PEDALS = ("station.kp", "speed.kp_low", "speed.ki_low", "speed.kp_high", "speed.ki_high")
# Factors on the first manual set: Q acts by about its root, so 16 is four times the gain. Sharp ones shake, slow ones
# lag behind; each spoils one aspect and leaves the other as it is.
VARIED_SETS: dict[str, tuple[tuple[str, ...], float]] = {
    "sharp_steering": (STEERING, 16.0),
    "slow_steering": (STEERING, 1.0 / 16.0),
    "sharp_pedals": (PEDALS, 4.0),
    "slow_pedals": (PEDALS, 0.25),
}
RANDOM = "random"

# Drivers of the model: a choice, of the order of the reaction times and lags in MacAdam 2003 (driver/pedals.py).
_TYPICAL = {
    "driver.reaction_s": 0.17,
    "driver.bandwidth_radps": 0.7,
    "driver.damping": 1.0,
    "driver.arm_lag_s": 0.1,
    "driver.speed_1ps": 1.2,
    "driver.station_1ps": 0.25,
    "driver.integral_1ps2": 0.05,
    "driver.foot_lag_s": 0.1,
    "mrac.enable": 0.0,
}
DRIVERS: dict[str, dict[str, float]] = {
    "driver_calm": {
        **_TYPICAL,
        "driver.reaction_s": 0.2,
        "driver.bandwidth_radps": 0.55,
        "driver.arm_lag_s": 0.12,
        "driver.speed_1ps": 1.0,
        "driver.foot_lag_s": 0.12,
    },
    "driver_typical": _TYPICAL,
    "driver_alert": {**_TYPICAL, "driver.reaction_s": 0.13, "driver.bandwidth_radps": 0.85, "driver.arm_lag_s": 0.08},
}
# A driver who knows the vehicle looks ahead by its delay, that of arms or foot, and what follows wheel and pedal. These
# two were chosen for a small tracking error of `driver_typical` on made roads of one vehicle (seeds 1 and 5).
AFTER_WHEEL_S = 0.1
AFTER_PEDAL_S = 0.08


def make_driver_vectors(driver_bench: Bench) -> dict[str, dict[str, float]]:
    """Complete vectors of the drivers by name, for a bench with the driver model as its controller."""
    delays = identified_of(driver_bench, constants_of(driver_bench.vehicle)).delays
    cutoff_hz = settings_of(driver_bench).cutoff_hz
    steer_s = delays.steer_dead_time_s + delays.steer_lag_s + delays.bus_s + butterworth_delay_s(cutoff_hz)
    drive_s = delays.drive_dead_time_s + delays.drive_lag_s + delays.bus_s
    vectors = {}
    for name, values in DRIVERS.items():
        preview = {
            STEER_PREVIEW: 1.0 + (2.0 * values["driver.arm_lag_s"] + AFTER_WHEEL_S) / steer_s,
            PEDAL_PREVIEW: drive_s + 2.0 * values["driver.foot_lag_s"] + AFTER_PEDAL_S,
        }
        vectors[name] = parameters_of(driver_bench, {**values, **preview})
    return vectors


def make_gain_sets(bench: Bench, n_random: int, seed: int) -> dict[str, dict[str, float]]:
    """Complete vectors by name: the manual ones, sharp and slow ones, and random ones from both boxes in turn.

    Raises:
        InputError: The bench has a controller of the user, whose parameters have no box here.
    """
    if has_foreign_controller(bench):
        raise InputError(
            "pairs are driven with the built-in controller's sets of gains",
            code="not_built_in",
            file=bench.file,
            key="controller",
            hint="name a bench file with a built-in controller, or give a file of pairs",
        )
    vectors = compute_baseline_vectors(bench)
    first = select_first_vector(vectors)
    sets = {name: dict(values) for name, values in vectors.items()}
    for name, (parameters, factor) in VARIED_SETS.items():
        sets[name] = parameters_of(bench, {**first, **_scaled(first, parameters, factor)})
    chance = Random(f"weights {seed} {bench.vehicle.name}")
    for number in range(n_random):
        box = BoxChoice.PAPER if number % 2 else BoxChoice.DEFAULT
        drawn = {name: _draw_value(tunable_in_box(name, box), chance) for name in SETS["complete"]}
        sets[f"{RANDOM} {number + 1}"] = parameters_of(bench, {**first, **drawn})
    return sets


def _scaled(values: Mapping[str, float], names: tuple[str, ...], factor: float) -> dict[str, float]:
    """The values times a factor, within the wider box; a value of 0 counts as the low edge of the box."""
    scaled = {}
    for name in names:
        box = tunable_in_box(name, BoxChoice.DEFAULT)
        scaled[name] = round32(min(max((values[name] or box.low) * factor, box.low), box.high))
    return scaled


def _draw_value(tunable: Tunable, chance: Random) -> float:
    if tunable.scale == "log":
        return round32(tunable.low * (tunable.high / tunable.low) ** chance.random())
    return round32(chance.uniform(tunable.low, tunable.high))
