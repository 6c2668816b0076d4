"""Checks of scenario, weights, bench and model files, beyond the types. Each yields `ConfigProblem`s."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GROUPS
from tunefree_hil.config.fault_check import check_faults
from tunefree_hil.config.find import nearest
from tunefree_hil.config.problem import ConfigProblem, Problems
from tunefree_hil.config.schema import (
    BenchSpec,
    ControllerSpec,
    Interval,
    ModelSpec,
    ParameterSpec,
    ProfileSpec,
    RoadsSpec,
    ScenarioSpec,
    WeightsSpec,
    value_of,
)
from tunefree_hil.config.tuning.ensemble_schema import check_ensemble
from tunefree_hil.config.tuning.require_schema import check_require

# The names of docs/reference/controller.md; control/parameters.py has their boxes.
PARAMETERS = (
    *("mrac.t_ref_s", "mrac.p"),
    *("lqr.q1", "lqr.q2", "lqr.q3", "lqr.q4"),
    *("station.kp", "speed.kp_low", "speed.ki_low", "speed.kp_high", "speed.ki_high"),
    *("mrac.enable", "riccati", "mrac.clamp_s", "mrac.gamma", "look_ahead_m"),
)
CHANNELS = ("throttle", "brake", "steer", "accel", "steer_torque")  # that a model's [actuators] may have
# Metrics that weights may name; grade/score.py has them.
METRICS = (
    *("station_err_std", "station_err_std_harsh", "speed_err_std", "speed_err_std_harsh"),
    *("lateral_err_std", "lateral_err_std_harsh", "heading_err_std", "heading_err_std_harsh"),
    *("heading_err_rate_std", "heading_err_rate_std_harsh"),
    *("station_err_peak", "speed_err_peak", "lateral_err_peak", "heading_err_peak", "heading_err_rate_peak"),
    *("steer_rate_rms", "lateral_jerk_rms", "steering_control_usage"),
    *("lateral_rms_after_start", "station_rms_after_start", "speed_rms_after_start", "heading_rms_after_start"),
    *("start_overshoot", "start_settling"),
    *("lateral_peak_after_start", "station_peak_after_start", "speed_peak_after_start", "heading_peak_after_start"),
    *("longitudinal_jerk_rms", "pedal_rate_rms", "pedal_alternation"),
)
# Far beyond any drive: a larger number is a mistake, and some would overflow where a course is built.
MOST = {"speed": 1e3, "curvature": 1e3, "grade": 1.5, "friction": 1e3, "bank": 1.5, "side_wind": 1e3}  # SI; angles rad
PROFILES = tuple(MOST)  # of a scenario, over time
MOST_START = {"along_m": 1e6, "lateral_m": 1e6, "heading_rad": 1e3, "speed_mps": 1e3}
MOST_S, MOST_M = 86_400.0, 1e6
MOST_SEED = 65535  # EPISODE carries it in 16 bits


class RoadSetSize(NamedTuple):
    """How many roads a set may have."""

    usual: int
    least: int
    most: int


# Sets of made roads (roads/sets.py). Fewer than 1000 say little about robustness.
ROAD_SETS = {
    "families": RoadSetSize(20, 1, 1000),
    "public229": RoadSetSize(229, 229, 229),
    "robust": RoadSetSize(1000, 1000, 10_000),
}
MOST_ROAD_SEED = 9999  # a verification has the seeds above


class RoadSetChoice(NamedTuple):
    """A set of made roads and their number."""

    name: str
    count: int


def parse_road_set(text: str) -> RoadSetChoice:
    """NAME or NAME:COUNT, such as 'families:20'. Raises InputError for an unknown set and a count that does not fit."""
    name, colon, number = text.partition(":")
    size = ROAD_SETS.get(name)
    if size is None:
        hint = nearest(name, ROAD_SETS)
        raise InputError(f"no set of roads {name!r}", code="unknown_road_set", key="roads", hint=hint)
    count = int(number) if number.isascii() and number.isdigit() else -1
    if not colon:
        count = size.usual
    if not size.least <= count <= size.most:
        span = f"{size.least} to {size.most}" if size.least < size.most else f"{size.least}"
        raise InputError(
            f"{text!r}: {name} has {span} roads",
            code="bad_road_count",
            key="roads",
            hint=f"{name}:{size.usual}, for example" if size.least < size.most else f"write {name}",
        )
    return RoadSetChoice(name, count)


def check_scenario(spec: ScenarioSpec) -> Problems:
    """Profiles fit, nothing drives backwards, the seed fits its place on the bench channel."""
    for name in PROFILES:
        profile = getattr(spec, name)
        if profile is not None:
            yield from _profile(name, profile)
            yield from _most(f"{name}.value", profile.value, MOST[name])
    for name, most in MOST_START.items():
        yield from _most(f"start.{name}", [getattr(spec.start, name)], most)
    if any(value < 0.0 for value in spec.speed.value):
        yield ConfigProblem("speed.value", "a speed is below 0", "scenarios drive forwards")
    if spec.start.speed_mps < 0.0:
        yield ConfigProblem("start.speed_mps", f"{spec.start.speed_mps:g} is below 0", "scenarios drive forwards")
    if spec.friction is not None and any(value <= 0.0 for value in spec.friction.value):
        yield ConfigProblem("friction.value", "a friction is not above 0", "1.0 is the model's own friction")
    if not 0 <= spec.noise_seed <= MOST_SEED:
        yield ConfigProblem("noise_seed", f"{spec.noise_seed} does not fit", f"give 0 to {MOST_SEED}")
    if spec.speed.t_s and spec.speed.t_s[-1] <= 0.0:
        yield ConfigProblem("speed.t_s", "the scenario lasts 0 s", "the last t_s is its duration")
    yield from _length(spec.speed)


def _length(speed: ProfileSpec) -> Problems:
    """A course holds every tick and every bit of its path."""
    duration_s, fastest_mps = max(speed.t_s, default=0.0), max(speed.value, default=0.0)
    if duration_s > MOST_S:
        yield ConfigProblem(
            "speed.t_s", f"the scenario lasts {duration_s:g} s", f"a scenario lasts {MOST_S:g} s at most"
        )
    elif fastest_mps <= MOST["speed"] and fastest_mps * duration_s > MOST_M:
        words = f"{duration_s:g} s at up to {fastest_mps:g} m/s may be {fastest_mps * duration_s:g} m"
        yield ConfigProblem("speed", words, f"a scenario is {MOST_M:g} m long at most")


def _most(key: str, values: Sequence[float], most: float) -> Problems:
    beyond = [value for value in values if abs(value) > most]
    if beyond:
        yield ConfigProblem(key, f"{beyond[0]:g} is beyond {most:g}", "is the unit right?")


def _profile(name: str, profile: ProfileSpec) -> Problems:
    times, values = profile.t_s, profile.value
    if len(times) != len(values):
        yield ConfigProblem(name, f"{len(times)} times in t_s, {len(values)} in value", "give one value for each time")
    if not times:
        yield ConfigProblem(f"{name}.t_s", "it is empty", "give at least one point")
        return
    if times[0] != 0.0:
        yield ConfigProblem(f"{name}.t_s", f"it begins at {times[0]:g} s", "begin at 0.0")
    for i in range(1, len(times)):
        if times[i] <= times[i - 1]:
            yield ConfigProblem(f"{name}.t_s[{i}]", f"{times[i]:g} is not above {times[i - 1]:g}", "times ascend")
            return


def check_weights(spec: WeightsSpec) -> Problems:
    """Weights are of known metrics, not negative and not all 0."""
    for name, weight in spec.metrics.items():
        if name not in METRICS:
            yield ConfigProblem(f"metrics.{name}", "no such metric", nearest(name, METRICS))
        if weight < 0.0:
            yield ConfigProblem(
                f"metrics.{name}", f"{weight:g} is below 0", "a lower score is better, so weights are not negative"
            )
    if sum(spec.metrics.values()) <= 0.0:
        yield ConfigProblem("metrics", "the weights add up to 0", "give at least one metric a weight")
    for name in ("failure_score", "lane_half_width_m", "divergence_heading_rad"):
        if getattr(spec, name) <= 0.0:
            yield ConfigProblem(name, f"{getattr(spec, name):g} is not above 0", "give a number above 0")
    if spec.largest_value < 0.0:
        yield ConfigProblem("largest_value", f"{spec.largest_value:g} is below 0", "give a number above 0, or 0")
    if spec.replan_penalty < 0.0:
        yield ConfigProblem("replan_penalty", f"{spec.replan_penalty:g} is below 0", "give a number from 0 on")


def check_bench(spec: BenchSpec) -> Problems:
    """Names, boxes and counts."""
    if not spec.scenarios and not (spec.roads and spec.roads.search):
        yield ConfigProblem("scenarios", "it is empty", "name at least one scenario, or roads.search")
    if spec.roads is not None:
        yield from _roads(spec.roads)
    plain = ControllerSpec()
    parts = ("lateral", "longitudinal", "inner")
    has_own_parts = any(getattr(spec.controller, part) != getattr(plain, part) for part in ("command", *parts))
    if spec.controller.command and not all(spec.controller.command):
        yield ConfigProblem("controller.command", "a word of it is empty", "give the program, then its arguments")
    for name in spec.controller.parameters:
        if name not in PARAMETERS and not has_own_parts and not is_foreign(name):
            yield ConfigProblem(f"controller.parameters.{name}", "no such parameter", nearest(name, PARAMETERS))
    if not 0.0 <= spec.controller.mrac_dead_zone <= 100.0:
        yield ConfigProblem(
            "controller.mrac_dead_zone", f"{spec.controller.mrac_dead_zone:g}", "percent of the limit, 0 to 100"
        )
    yield from _tune(spec, has_own_parts)
    if spec.require is not None:
        yield from check_require(spec.require)
    if spec.ensemble is not None:
        yield from check_ensemble(spec.ensemble)
        yield from _road_set("ensemble.select_roads", spec.ensemble.select_roads)
    yield from check_faults(spec.faults)


def _roads(roads: RoadsSpec) -> Problems:
    for key in ("search", "verify"):
        yield from _road_set(f"roads.{key}", getattr(roads, key))
    if not roads.search and not roads.verify:
        yield ConfigProblem("roads", "it names no set", 'give search = "families:20", or leave it out')
    if not 0 <= roads.seed <= MOST_ROAD_SEED:
        yield ConfigProblem("roads.seed", f"{roads.seed} does not fit", f"give 0 to {MOST_ROAD_SEED}")


def _road_set(key: str, text: str) -> Problems:
    try:
        if text:
            parse_road_set(text)
    except InputError as error:
        yield ConfigProblem(key, error.message, error.hint)


def is_foreign(name: str) -> bool:
    """Whether a name may belong to a foreign controller: 'group.name' of a group that is none of ours.

    Whether that controller has it is known after its HELLO (docs/reference/bench_channel.md).
    """
    group, dot, rest = name.partition(".")
    return bool(group and dot and rest) and group not in {known.partition(".")[0] for known in PARAMETERS}


def _tune(spec: BenchSpec, has_own_parts: bool) -> Problems:
    tune = spec.tune
    if tune.trials < 1:
        yield ConfigProblem("tune.trials", f"{tune.trials} is below 1", "give a whole number from 1 on")
    if tune.in_flight < 0:
        yield ConfigProblem("tune.in_flight", f"{tune.in_flight} is below 0", "give a whole number from 0 on")
    seen: set[str] = set()
    for i, parameter in enumerate(tune.parameters):
        key = f"tune.parameters[{i}]"
        if parameter.name not in PARAMETERS and not has_own_parts and not is_foreign(parameter.name):
            yield ConfigProblem(f"{key}.name", f"no parameter {parameter.name!r}", nearest(parameter.name, PARAMETERS))
        if parameter.name in seen:
            yield ConfigProblem(f"{key}.name", f"{parameter.name} is listed twice", "remove one")
        seen.add(parameter.name)
        yield from _box(key, parameter)


def _box(key: str, parameter: ParameterSpec) -> Problems:
    if parameter.choices is not None:
        if not parameter.choices:
            yield ConfigProblem(f"{key}.choices", "it is empty", "give the values there are")
        return
    # A parameter of docs/reference/controller.md without a box is searched in the one it has there (tune/space.py).
    boxed = parameter.low != 0.0 or parameter.high != 0.0 or parameter.name not in PARAMETERS
    if boxed and parameter.low >= parameter.high:
        yield ConfigProblem(
            f"{key}.low", f"low {parameter.low:g} is not below high {parameter.high:g}", "give low < high, or choices"
        )
    elif boxed and parameter.scale == "log" and parameter.low <= 0.0:
        yield ConfigProblem(f"{key}.low", f"{parameter.low:g} on a log scale", 'give low > 0, or scale = "linear"')
    if parameter.step is not None and parameter.step <= 0.0:
        yield ConfigProblem(f"{key}.step", f"{parameter.step:g} is not above 0", "give a step above 0, or none")


def check_model(spec: ModelSpec) -> Problems:
    """Intervals hold their value, times are not negative, names are record fields."""
    for channel, actuator in spec.actuators.items():
        if channel not in CHANNELS:
            yield ConfigProblem(f"actuators.{channel}", "no channel of an actuator", nearest(channel, CHANNELS))
        for name in ("dead_time_s", "lag_s", "natural_hz", "damping", "rate_limit", "dead_band", "gain", "offset"):
            number, key = getattr(actuator, name), f"actuators.{channel}.{name}"
            value = value_of(number)
            if isinstance(number, Interval) and not number.low <= number.value <= number.high:
                yield ConfigProblem(
                    key, f"{number.value:g} is outside {number.low:g} to {number.high:g}", "low <= value <= high"
                )
            if name not in ("gain", "offset") and value < 0.0:
                yield ConfigProblem(key, f"{value:g} is below 0", "give a number from 0 on")
        if actuator.order == 2 and not value_of(actuator.natural_hz) > 0.0:
            yield ConfigProblem(f"actuators.{channel}.natural_hz", "order 2 needs it", "give natural_hz and damping")
    for table in ("noise", "bias"):
        yield from _record_keys(table, list(getattr(spec, table)))
    for name, deviation in spec.noise.items():
        if deviation < 0.0:
            yield ConfigProblem(f"noise.{name}", f"{deviation:g} is below 0", "give a standard deviation")
    for name in ("report_ticks", "command_ticks", "phase_seed"):
        if getattr(spec.timing, name) < 0:
            yield ConfigProblem(f"timing.{name}", "it is below 0", "give a whole number from 0 on")
    for name in ("speed_mps", "accel_mps2", "lateral_accel_mps2", "pedals", "steer_rad"):
        ends = getattr(spec.valid, name)
        if ends is not None and (len(ends) != 2 or ends[0] >= ends[1]):
            yield ConfigProblem(f"valid.{name}", f"expected [low, high], got {ends}", "give two ascending numbers")


def _record_keys(table: str, names: Sequence[str]) -> Problems:
    known = [f"{group}.{name}" for group in ("report", "ins") for name in GROUPS[group]._fields]
    for name in names:
        if name not in known:
            yield ConfigProblem(f"{table}.{name}", "no such record field", nearest(name, known))
