"""Results of a fit: values with intervals, and whether the logs identify them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from tunefree_hil.plant.actuation.actuators import ActuatorParams

HALF_WIDTH_95 = 1.96  # half width of a 95 % interval in standard deviations


class Estimate(NamedTuple):
    """A number with its 95 % interval. The names of CARD_FIELDS are keys of card.json.

    Attributes:
        value: The number.
        low: Lower end of the interval.
        high: Upper end of the interval.
        known: True: the logs identify it. False: `value` is the data sheet's or neutral, and the interval is widened.
        why: The reason, where it is not identified; only shown.
        is_needed: False: the model reproduces the logs without it, so that it is not fitted.
    """

    value: float
    low: float
    high: float
    known: bool = True
    why: str = ""
    is_needed: bool = True


CARD_FIELDS = ("value", "low", "high", "known", "why")


def make_exact_estimate(value: float, why: str = "") -> Estimate:
    """A number that was chosen and not fitted: an interval of width 0."""
    return Estimate(value, value, value, True, why)


def make_unidentified_estimate(
    value: float, why: str, *, low: float | None = None, high: float | None = None, by_share: float = 0.5
) -> Estimate:
    """A data sheet value, widened to both sides by a share of it where `low` or `high` is not given."""
    spread = by_share * abs(value) if math.isfinite(value) else 0.0
    return Estimate(value, value - spread if low is None else low, value + spread if high is None else high, False, why)


def replace_value(estimate: Estimate, value: float, why: str) -> Estimate:
    """Another, unidentified value; the interval is widened to contain it."""
    return Estimate(value, min(estimate.low, value), max(estimate.high, value), False, why)


class ActuatorFit(NamedTuple):
    """An identified by-wire channel, in its own unit (duty, rad at the steering wheel, m/s2, Nm).

    Order 1 uses lag_s (natural_hz is 0), order 2 natural_hz and damping (lag_s is 0).

    Attributes:
        noise: Standard deviation of the reported output.
        quantum: Resolution of the reported output.
        error: RMS of simulated minus reported output on held-out parts; NaN where there are none.
        rows: Number of compared reports.
        report: How the channel was identified.
    """

    dead_time_s: Estimate
    order: int
    lag_s: Estimate
    natural_hz: Estimate
    damping: Estimate
    rate_limit: Estimate
    dead_band: Estimate
    gain: Estimate
    offset: Estimate
    noise: float = 0.0
    quantum: float = 0.0
    error: float = math.nan
    rows: int = 0
    report: str = ""

    def estimates(self) -> dict[str, Estimate]:
        """The fitted values by their names in model.toml, without those of the other order."""
        dynamics = ("lag_s",) if self.order == 1 else ("natural_hz", "damping")
        names = ("dead_time_s", *dynamics, "rate_limit", "dead_band", "gain", "offset")
        return {name: getattr(self, name) for name in names}

    def params(self, rest: float = 0.0, initial: float | None = None) -> ActuatorParams:
        """Parameters of the actuator kernel. initial: the command before tick 0, None for `rest`."""
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
        """Rise time of the response to a small step after the dead time, 0 to 63 %."""
        if self.order == 1:
            return float(self.lag_s.value)
        return compute_rise_63_s(self.natural_hz.value, self.damping.value)


def compute_rise_63_s(natural_hz: float, damping: float) -> float:
    """Time in which a second-order lag reaches 1 - 1/e of a step, by bisection of its step response."""
    from tunefree_hil.plant.actuation.actuators import init_actuator

    goal = 1.0 - math.exp(-1.0)
    params = ActuatorParams(order=2.0, natural_hz=float(natural_hz), damping=float(damping))
    low, high = 0.0, 1.0 / natural_hz  # config/check.py requires natural_hz > 0
    while init_actuator(params, high).lag.output_new < goal:
        low, high = high, 2.0 * high
    for _ in range(60):
        middle = 0.5 * (low + high)
        if init_actuator(params, middle).lag.output_new < goal:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def data_from_estimates(estimates: Mapping[str, Estimate]) -> dict[str, Any]:
    """Plain data for card.json; numbers that are not finite become null, which means 'no limit' there."""
    return {
        name: {key: _null_if_infinite(getattr(estimate, key)) for key in CARD_FIELDS}
        for name, estimate in estimates.items()
    }


def _null_if_infinite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
