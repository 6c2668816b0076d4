"""Model-reference adaptive control of the steering actuator: eq. 5 and 6 of the paper, docs/reference/apollo.md.

Inside this file signals are percent of the steering limit (the box of `mrac.p` presumes it), x = [angle, its rate, ..].
Form "apollo" is the shipped law (bounds, anti-windup, clamping rule), form "paper" is eq. 6 only.
The law has no dead time: with the actuator of the data sheet the loop is stable up to |Kx| of about 1.5 (test_mrac).
mrac.clamp_s = 0.08 s keeps |Kx| below 0.54, 0.01 s allows 11, which a p of 1e-3 reaches in a tight turn.
On a straight road only noise and sensor offsets drive eq. 6, and the gains drift.
Settings.mrac_dead_zone ignores an error that small (dead-zone modification: Peterson and Narendra 1982,
Ioannou and Sun, Robust Adaptive Control, 8.4.3), continuously: of a larger error the part above it is used.
The models of each order are in control/mrac_model.py. Start gains and clamp are computed from the actuator lag of the
data sheet, without which MRAC is refused.

Derivatives. Order 2 takes the difference of two ticks, as Apollo does: one bit of the report is then as much as 2 % a
second. From order 3 on each derivative goes through a lag of FILTER_S, and those of the reference through the same
lags, so that no delay of a filter is taken for an error of the actuator (state-variable filters: Young 1981, Automatica
17, 23-39).
"""

from __future__ import annotations

from typing import Any, NamedTuple

from tunefree_hil.base.contracts import Block
from tunefree_hil.base.kernel import buffer, kernel, table
from tunefree_hil.base.maths import clamp, is_finite
from tunefree_hil.control.contract import InnerAnswer, LoopDelays, Recipe, Setup
from tunefree_hil.control.limits import SteerBound, steer_bound, steer_bound_of
from tunefree_hil.control.mrac_model import (
    ReferenceModel,
    actuator_tau_s,
    check_order,
    lead_shares,
    lyapunov_pb,
    reference_model,
    start_gains,
    time_unit_s,
)
from tunefree_hil.control.mrac_needs import require_needs
from tunefree_hil.control.parameters import tunables_of

ADAPT_ABOVE_MPS = 0.2
RATE_PERCENT_PER_S = 10000.0  # of the reference and the output, as in Apollo (the rate of the wheel is limited later)
FILTER_S = 0.02  # lag of each derivative from order 3 on: one period of a steering report


class Differentiator(NamedTuple):
    """A derivative in the model's unit of time: (value - low) / span, and low goes a share of the way to the value."""

    span: float
    share: float


class MracParams(NamedTuple):
    """Everything in percent, derivatives in units of `unit_s`. Flags are 0 or 1. Rows have the order's length."""

    enable: float
    plain: float
    filtered: float  # order 3 and more
    percent_per_rad: float
    reference: ReferenceModel
    differentiator: Differentiator
    unit_s: float
    pb: Any  # P B
    gamma: float
    dead_zone: float
    anti_windup: float
    clamped: float
    x_low: Any
    r_high: float
    start: Any  # gains on the angle and its derivatives
    start_command: float
    bound: SteerBound


class MracState(NamedTuple):
    """Gains, and values of the last tick for the trapezoidal rule. Rows have the order's length."""

    begun: float
    gains: Any
    trial: Any  # gains that may break the clamp, and other intermediate values
    reference: Any  # of the model
    angle: Any  # the angle and its derivatives: now
    last_angle: Any
    angle_lows: Any  # of their differentiators
    target: Any  # the reference's angle and derivatives
    target_lows: Any
    command_gain: float
    command: float
    pull: float  # (e + aw)' P B
    windup: float  # of the angle
    rate_windup: float
    out: float


class Output(NamedTuple):
    """The command within its bounds, which bound it met, and the anti-windup of the next tick."""

    value: float
    status: float
    windup: float
    rate_windup: float


def make(setup: Setup) -> Block:
    """x = (steer demand rad, measured steer rad, speed m/s) -> InnerAnswer; with mrac.enable = 0 the demand itself.

    Raises InputError for a vehicle without its needs (control/mrac_needs.py), and for settings that are not valid.
    """
    values, vehicle, settings = setup.values, setup.vehicle, setup.settings
    enable = 1.0 if values["mrac.enable"] >= 0.5 else 0.0
    tau_s = actuator_tau_s(vehicle)
    if enable:
        require_needs(setup, tau_s)
        check_order(settings, vehicle, setup.dt_s)
    else:
        settings = settings._replace(mrac_order=1)  # switched off it needs nothing of the vehicle
    clamp_s, t_ref_s = values["mrac.clamp_s"], values["mrac.t_ref_s"]
    order, plain = settings.mrac_order, settings.mrac_form == "paper"
    reference = reference_model(t_ref_s, settings, vehicle, setup.dt_s)
    unit_s, start = time_unit_s(t_ref_s, settings, vehicle), start_gains(t_ref_s, vehicle, settings)
    r_high = tau_s / clamp_s if clamp_s > 0.0 else 0.0
    shares = lead_shares(settings, vehicle, unit_s) if order != 2 else (1.0, 0.0)
    params = MracParams(
        enable=enable,
        plain=1.0 if plain else 0.0,
        filtered=1.0 if order > 2 else 0.0,
        percent_per_rad=100.0 / vehicle.steer_limit_rad,
        reference=reference,
        differentiator=make_differentiator(order, unit_s, setup.dt_s),
        unit_s=unit_s,
        pb=table(lyapunov_pb(t_ref_s, values["mrac.p"], settings, vehicle)),
        gamma=values["mrac.gamma"],
        dead_zone=0.0 if plain else settings.mrac_dead_zone,
        anti_windup=0.0 if plain else settings.mrac_anti_windup,
        clamped=1.0 if clamp_s > 0.0 and order != 2 and not plain else 0.0,
        x_low=table(share * (1.0 - r_high) if clamp_s > 0.0 else 0.0 for share in shares),
        r_high=r_high,
        start=table(start.angle),
        start_command=start.command,
        bound=steer_bound_of(setup),
    )
    return Block(init, step, params, CONTROLLER.tunables)


def make_differentiator(order: int, unit_s: float, dt_s: float) -> Differentiator:
    """The plain difference of two ticks up to order 2, above it through a lag (backward Euler)."""
    if order <= 2:
        return Differentiator(dt_s, 1.0)
    return Differentiator((FILTER_S + dt_s) / unit_s, dt_s / (FILTER_S + dt_s))


def init(params: MracParams, dt_s: float) -> MracState:
    order = len(params.start)
    gains = buffer(order)
    for i in range(order):
        gains[i] = params.start[i]
    return MracState(
        begun=0.0,
        gains=gains,
        trial=buffer(order),
        reference=buffer(order),
        angle=buffer(order),
        last_angle=buffer(order),
        angle_lows=buffer(order),
        target=buffer(order),
        target_lows=buffer(order),
        command_gain=params.start_command,
        command=0.0,
        pull=0.0,
        windup=0.0,
        rate_windup=0.0,
        out=0.0,
    )


@kernel
def step(
    params: MracParams, state: MracState, x: tuple[float, float, float], dt_s: float
) -> tuple[MracState, InnerAnswer]:
    """delta_mrac = Kx x + Kr r (eq. 6), all in percent."""
    wish_rad, measured_rad, speed_mps = x
    if params.enable == 0.0:
        return state, InnerAnswer(wish_rad, 0.0)
    total = wish_rad + measured_rad + speed_mps
    if not is_finite(total):  # the cascade refuses such a tick and keeps the state of before it
        return state, InnerAnswer(total, 0.0)
    command, angle = wish_rad * params.percent_per_rad, measured_rad * params.percent_per_rad
    last_command, last_out, command_gain = state.command, state.out, state.command_gain
    if state.begun == 0.0:
        begin(params, state, angle)
        last_command, last_out = command, angle
    largest = steer_bound(params.bound, speed_mps) * params.percent_per_rad
    if params.plain != 0.0:
        largest = 1e9
    gains, row = state.gains, state.angle
    for i in range(len(row)):
        state.last_angle[i] = row[i]
    fill_derivatives(row, state.angle_lows, params.differentiator, angle)
    follow(params, state, command + last_command, largest, dt_s)
    pull = adaptation_error(params, state)
    if abs(speed_mps) >= ADAPT_ABOVE_MPS:
        command_gain = adapt(params, state, command, last_command, pull, dt_s)
    free = 0.0
    for i in range(len(row)):
        free += gains[i] * row[i]
    free += command_gain * command
    out = limit_output(params, free, last_out, largest, dt_s)
    new_state = MracState(
        1.0, gains, state.trial, state.reference, row, state.last_angle, state.angle_lows, state.target,
        state.target_lows, command_gain, command, pull, out.windup, out.rate_windup, out.value,
    )  # fmt: skip
    return new_state, InnerAnswer(out.value / params.percent_per_rad, out.status)  # not 0: 100 over a finite limit


@kernel
def begin(params: MracParams, state: MracState, angle: float) -> None:
    """The first tick: start gains, actuator and reference stand at the measured angle.

    The cascade may begin more than once: it keeps the state of before a tick in which another part has no number.
    """
    for i in range(len(state.angle)):
        is_angle = i == 0 or params.filtered != 0.0  # from order 3 on every state of the model is an angle
        state.reference[i] = angle if is_angle else 0.0
        state.gains[i] = params.start[i]
        state.angle[i], state.angle_lows[i], state.target[i], state.target_lows[i] = 0.0, 0.0, 0.0, 0.0
    state.angle[0], state.target[0] = angle, angle
    if len(state.angle) > 1:
        state.angle_lows[1], state.target_lows[1] = angle, angle


@kernel
def fill_derivatives(row: Any, lows: Any, differentiator: Differentiator, value: float) -> None:
    """A value and its derivatives into a row; lows[i] is what the differentiator of the i-th one remembers."""
    row[0] = value
    for i in range(1, len(row)):
        rise = row[i - 1] - lows[i]
        row[i] = rise / differentiator.span  # not 0: a tick or more
        if differentiator.share == 1.0:
            lows[i] = row[i - 1]
        else:
            lows[i] += differentiator.share * rise


@kernel
def follow(params: MracParams, state: MracState, drive: float, largest: float, dt_s: float) -> None:
    """The reference model of eq. 5 a tick later, and the target: its angle and derivatives. drive: r[k] + r[k-1]."""
    model, reference, order = params.reference, state.reference, len(state.angle)
    for i in range(order):
        total = 0.0
        for j in range(order):
            total += model.m[i * order + j] * reference[j]
        state.trial[i] = total + model.n[i] * drive
    if params.plain == 0.0:
        state.trial[0], _ = bounded(state.trial[0], reference[0], largest, dt_s)
    for i in range(order):
        reference[i] = state.trial[i]
        state.target[i] = state.trial[i]
    if params.filtered != 0.0:
        fill_derivatives(state.target, state.target_lows, params.differentiator, reference[0])


@kernel
def adaptation_error(params: MracParams, state: MracState) -> float:
    """(e + aw)' P B, of an error above the dead zone."""
    first = state.angle[0] - state.target[0] + state.windup
    total = first * params.pb[0]
    for i in range(1, len(state.angle)):
        error = state.angle[i] - state.target[i]
        if i == 1:
            error += state.rate_windup
        total += error * params.pb[i]
    return beyond(first, params.dead_zone) * total


@kernel
def beyond(error: float, dead_zone: float) -> float:
    """Share of an error above the dead zone: 0 within it, 1 far above or without a dead zone."""
    size = abs(error)
    if size <= dead_zone:
        return 1.0 if dead_zone == 0.0 else 0.0
    return (size - dead_zone) / size  # size > dead_zone >= 0


@kernel
def adapt(params: MracParams, state: MracState, command: float, last_command: float, pull: float, dt_s: float) -> float:
    """Eq. 6: K' = -gamma phi (e' P B), trapezoidal (Euler in the paper's form), within the clamp or not at all.

    The gains of the angle are changed in the state; returns the gain of the command.
    """
    gains, now, last = state.gains, state.angle, state.last_angle
    if params.plain != 0.0:
        share = dt_s * params.gamma * pull
        for i in range(len(gains)):
            gains[i] -= share * now[i]
        return state.command_gain - share * command
    half = 0.5 * dt_s * params.gamma
    command_gain = state.command_gain - half * (command * pull + last_command * state.pull)
    # If one leaves its range all are reset. A reference slower than the assumed actuator starts outside: frozen.
    outside = command_gain < 1.0 or command_gain > params.r_high
    for i in range(len(gains)):
        gain = gains[i] - half * (now[i] * pull + last[i] * state.pull)
        outside = outside or gain > 0.0 or gain < params.x_low[i]
        state.trial[i] = gain
    if params.clamped != 0.0 and outside:
        return state.command_gain
    for i in range(len(gains)):
        gains[i] = state.trial[i]
    return command_gain


@kernel
def limit_output(params: MracParams, free: float, last: float, largest: float, dt_s: float) -> Output:
    """The output within size and rate, with the anti-windup for what was cut off; higher derivatives have no bound."""
    if params.plain != 0.0:
        return Output(free, 0.0, 0.0, 0.0)
    out, status = bounded(free, last, largest, dt_s)
    if status == 0.0:
        return Output(out, status, 0.0, 0.0)
    windup, rate_windup = params.anti_windup * (clamp(free, -largest, largest) - free), 0.0
    if len(params.pb) > 1:
        speed = (free - last) / dt_s
        rate_windup = params.anti_windup * (clamp(speed, -RATE_PERCENT_PER_S, RATE_PERCENT_PER_S) - speed)
        rate_windup *= params.unit_s
    return Output(out, status, windup, rate_windup)


@kernel
def bounded(free: float, last: float, largest: float, dt_s: float) -> tuple[float, float]:
    """(value within size and rate, status: 0, +/-1 size, +/-2 rate)."""
    value, status = free, 0.0
    if value > largest:
        value, status = largest, 1.0
    elif value < -largest:
        value, status = -largest, -1.0
    reach = RATE_PERCENT_PER_S * dt_s
    if value > last + reach:
        value, status = last + reach, 2.0
    elif value < last - reach:
        value, status = last - reach, -2.0
    return value, status


def loop_lag_s(setup: Setup) -> float:
    """The lag from the demand to the wheel with the start gains; in the paper's form they change nothing."""
    lag_s, tau_s, settings = setup.delays.steer_lag_s, actuator_tau_s(setup.vehicle), setup.settings
    if setup.values["mrac.enable"] < 0.5 or tau_s <= 0.0 or settings.mrac_form == "paper":
        return lag_s
    t_ref_s = setup.values["mrac.t_ref_s"]
    start = start_gains(t_ref_s, setup.vehicle, settings)
    rate_s = start.angle[1] * time_unit_s(t_ref_s, settings, setup.vehicle) if settings.mrac_order > 1 else 0.0
    return lag_with_feedback_s(setup.delays, start.command, rate_s)


def lag_with_feedback_s(delays: LoopDelays, command_gain: float, rate_gain_s: float = 0.0) -> float:
    """The lag of u = (1 - r) angle + rate_gain rate + r command around an actuator.

    Its slow signals are (dead time + lag - rate gain) / r late. The measured angle comes one dead time late, so a gain
    r above 1 takes from the dead time too, and one below adds.
    """
    dead_s = delays.steer_dead_time_s + delays.bus_s
    return max((dead_s + delays.steer_lag_s - rate_gain_s) / command_gain - dead_s, 0.0)


CONTROLLER = Recipe(make, tunables_of("mrac."), loop_lag_s)
