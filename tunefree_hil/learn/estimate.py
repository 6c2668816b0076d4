"""What a fit says: a value with its interval, and whether these logs could show it at all."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from tunefree_hil.plant.actuation.actuators import ActuatorParams

NORMAL_95 = 1.96  # deviations to either end of a normal number's interval of 95 %


class Value(NamedTuple):
    """A number with its 95 % interval.

    known: the logs show it. Else it is the data sheet's (or neutral), low and high are widened, and `why` says what
    the logs lack.
    """

    value: float
    low: float
    high: float
    known: bool = True
    why: str = ""


def exactly(value: float, why: str = "") -> Value:
    """A number without doubt, because it was chosen and not fitted."""
    return Value(value, value, value, True, why)


def unknown(value: float, why: str, *, low: float | None = None, high: float | None = None, by: float = 0.5) -> Value:
    """A data sheet's number, widened to both sides by the fraction `by` of it unless low and high say otherwise."""
    spread = by * abs(value) if math.isfinite(value) else 0.0
    return Value(value, value - spread if low is None else low, value + spread if high is None else high, False, why)


def together_with(one: Value, value: float, why: str) -> Value:
    """Another value in the place of `one`, not known by itself, in an interval that holds both."""
    return Value(value, min(one.low, value), max(one.high, value), False, why)


class ActuatorFit(NamedTuple):
    """One by-wire channel as identified (design D5), in its own unit (duty, rad at the steering wheel, m/s2, Nm).

    order 1 has lag_s (and natural_hz = 0), order 2 natural_hz and damping (and lag_s = 0). noise: standard deviation
    of the reported output, quantum: its step on the wire. error: RMS of the simulated against the reported output on
    held-out parts (NaN where there are none), rows: how many reports were compared. words: how it was identified.
    """

    dead_time_s: Value
    order: int
    lag_s: Value
    natural_hz: Value
    damping: Value
    rate_limit: Value
    dead_band: Value
    gain: Value
    offset: Value
    noise: float = 0.0
    quantum: float = 0.0
    error: float = math.nan
    rows: int = 0
    words: str = ""

    def numbers(self) -> dict[str, Value]:
        """The fitted values by their names in model.toml; those of the other order are left out."""
        own = ("lag_s",) if self.order == 1 else ("natural_hz", "damping")
        names = ("dead_time_s", *own, "rate_limit", "dead_band", "gain", "offset")
        return {name: getattr(self, name) for name in names}

    def params(self, rest: float = 0.0, initial: float | None = None) -> ActuatorParams:
        """The kernel's params at these values. initial: the command held before tick 0, None for `rest`."""
        return ActuatorParams(
            dead_time_s=float(self.dead_time_s.value),
            order=float(self.order),
            lag_s=float(self.lag_s.value),
            natural_hz=float(self.natural_hz.value),
            damping=float(self.damping.value),
            rate_limit=float(self.rate_limit.value),
            dead_band=float(self.dead_band.value),
            gain=float(self.gain.value),
            offset=float(self.offset.value),
            rest=float(rest),
            initial=float(rest if initial is None else initial),
        )

    def lag_63_s(self) -> float:
        """Time in which the answer to a small step, once it has begun, reaches 63 %."""
        if self.order == 1:
            return float(self.lag_s.value)
        return rise_63_s(self.natural_hz.value, self.damping.value)


def rise_63_s(natural_hz: float, damping: float) -> float:
    """Time in which a second-order lag reaches 1 - 1/e of a step, by bisection of its step response."""
    from tunefree_hil.plant.actuation.actuators import init_actuator

    goal = 1.0 - math.exp(-1.0)
    params = ActuatorParams(order=2.0, natural_hz=float(natural_hz), damping=float(damping))
    low, high = 0.0, 1.0 / natural_hz  # natural_hz > 0: config/check.py refuses another
    while init_actuator(params, high).lag.output_new < goal:
        low, high = high, 2.0 * high
    for _ in range(60):
        middle = 0.5 * (low + high)
        if init_actuator(params, middle).lag.output_new < goal:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def as_data(values: Mapping[str, Value]) -> dict[str, Any]:
    """Values as plain data for card.json; what is not finite becomes null, which there means 'no limit'."""
    return {name: {key: _finite(one) for key, one in value._asdict().items()} for name, value in values.items()}


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
