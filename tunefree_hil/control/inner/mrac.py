"""Model-reference adaptive control of the steering actuator: eq. 5 and 6 of the paper, docs/reference/apollo.md.

Inside this file signals are percent of the steering limit (the box of `mrac.p` presumes it), x = [angle, its rate].
Form "apollo" is the shipped law (bounds, anti-windup, clamping rule), form "paper" is eq. 6 only.
The law has no dead time: with the actuator of the data sheet the loop is stable up to |Kx| of about 1.5 (test_mrac).
mrac.clamp_s = 0.08 s keeps |Kx| below 0.54, 0.01 s allows 11, which a p of 1e-3 reaches in a tight turn.
On a straight road only noise and sensor offsets drive eq. 6, and the gains drift.
Settings.mrac_dead_zone ignores an error that small (dead-zone modification: Peterson and Narendra 1982,
Ioannou and Sun, Robust Adaptive Control, 8.4.3), continuously: of a larger error the part above it is used.
Model order 1 has the reference time constant `mrac.t_ref_s`; order 2 its natural frequency and damping from Settings.
Start gains and clamp are computed from the actuator lag of the data sheet, without which MRAC is refused.
"""

from __future__ import annotations

from typing import NamedTuple

from tunefree_hil.base.contracts import Block
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import kernel
from tunefree_hil.base.maths import clamp
from tunefree_hil.control.contract import (
    RISE_PER_TAU,
    InnerAnswer,
    LoopDelays,
    Recipe,
    Settings,
    Setup,
    VehicleConstants,
)
from tunefree_hil.control.limits import SteerBound, steer_bound, steer_bound_of
from tunefree_hil.control.mrac_needs import require_needs
from tunefree_hil.control.parameters import tunables_of

ADAPT_ABOVE_MPS = 0.2
RATE_PERCENT_PER_S = 10000.0  # of the reference and the output, as in Apollo (the rate of the wheel is limited later)


class Gains(NamedTuple):
    """u = x1 angle + x2 rate + r command."""

    x1: float
    x2: float
    r: float


class Tustin(NamedTuple):
    """Reference model: x[k] = m x[k-1] + n (r[k] + r[k-1])."""

    m11: float
    m12: float
    m21: float
    m22: float
    n1: float
    n2: float


class MracParams(NamedTuple):
    """Everything in percent. Flags are 0 or 1."""

    enable: float
    plain: float
    order2: float
    percent_per_rad: float
    reference: Tustin
    pb1: float  # P B
    pb2: float
    gamma: float
    dead_zone: float
    anti_windup: float
    clamped: float
    x_low: float
    r_high: float
    start: Gains
    bound: SteerBound


class MracState(NamedTuple):
    """Gains, and values of the last tick for the trapezoidal rule."""

    begun: float
    gains: Gains
    ref1: float
    ref2: float
    angle: float
    rate: float
    command: float
    pull: float  # (e + aw)' P B
    windup1: float
    windup2: float
    out: float


def make(setup: Setup) -> Block:
    """x = (steer demand rad, measured steer rad, speed m/s) -> InnerAnswer; with mrac.enable = 0 the demand itself.

    Raises InputError for a vehicle without its needs (control/mrac_needs.py), and for settings that are not valid.
    """
    values, vehicle, settings = setup.values, setup.vehicle, setup.settings
    enable = 1.0 if values["mrac.enable"] >= 0.5 else 0.0
    tau_s = actuator_tau_s(vehicle)
    if enable:
        require_needs(setup, tau_s)
    order2 = settings.mrac_order == 2
    if settings.mrac_order not in (1, 2) or settings.mrac_form not in ("apollo", "paper"):
        raise InputError("mrac_order is 1 or 2, mrac_form 'apollo' or 'paper'", code="bad_mrac", key="controller")
    clamp_s = values["mrac.clamp_s"]
    plain = settings.mrac_form == "paper"
    pb1, pb2 = second_order_pb(values["mrac.p"], settings) if order2 else first_order_pb(values["mrac.p"])
    params = MracParams(
        enable=enable,
        plain=1.0 if plain else 0.0,
        order2=1.0 if order2 else 0.0,
        percent_per_rad=100.0 / vehicle.steer_limit_rad,
        reference=second_order(settings, setup.dt_s) if order2 else first_order(values["mrac.t_ref_s"], setup.dt_s),
        pb1=pb1,
        pb2=pb2,
        gamma=values["mrac.gamma"],
        dead_zone=0.0 if plain else settings.mrac_dead_zone,
        anti_windup=0.0 if plain else settings.mrac_anti_windup,
        clamped=1.0 if clamp_s > 0.0 and not order2 and not plain else 0.0,
        x_low=1.0 - tau_s / clamp_s if clamp_s > 0.0 else 0.0,
        r_high=tau_s / clamp_s if clamp_s > 0.0 else 0.0,
        start=start_gains(values["mrac.t_ref_s"], vehicle, settings),
        bound=steer_bound_of(setup),
    )
    return Block(init, step, params, CONTROLLER.tunables)


def actuator_tau_s(vehicle: VehicleConstants) -> float:
    """The lag for the dead time and rise time of the data sheet (MKZ: 0.1227 s)."""
    return (vehicle.steer_dead_time_s + vehicle.steer_rise_time_s) / RISE_PER_TAU


def start_gains(t_ref_s: float, vehicle: VehicleConstants, settings: Settings) -> Gains:
    """Gains with which the assumed actuator is the reference model; (0, 0, 1), no change, in the paper's form."""
    if settings.mrac_form == "paper" or vehicle.steer_rise_time_s <= 0.0:
        return Gains(0.0, 0.0, 1.0)
    if settings.mrac_order == 1:
        ratio = actuator_tau_s(vehicle) / t_ref_s
        return Gains(1.0 - ratio, 0.0, ratio)
    # Natural frequency 1.8 / rise time; damping 1 without a settling time.
    natural = 1.8 / vehicle.steer_rise_time_s
    square = natural * natural
    wish, damping = settings.mrac_natural_radps, settings.mrac_damping
    return Gains(1.0 - wish * wish / square, 2.0 * (natural - damping * wish) / square, wish * wish / square)


def first_order(t_ref_s: float, dt_s: float) -> Tustin:
    """a = -1/T, b = 1/T. Raises InputError for a time constant that is not positive."""
    if t_ref_s <= 0.0:
        raise InputError(
            f"mrac.t_ref_s = {t_ref_s} is no time constant", code="bad_mrac", key="mrac.t_ref_s", hint="give it above 0"
        )
    half = 0.5 * dt_s / t_ref_s
    return Tustin((1.0 - half) / (1.0 + half), 0.0, 0.0, 0.0, half / (1.0 + half), 0.0)


def second_order(settings: Settings, dt_s: float) -> Tustin:
    """A = [[0, 1], [-w^2, -2 d w]], B = [0, w^2]: (I - h A)^-1 (I + h A) and (I - h A)^-1 h B with h = dt/2."""
    h, w, d = 0.5 * dt_s, settings.mrac_natural_radps, settings.mrac_damping
    stiff, damp = h * w * w, 2.0 * h * d * w
    scale = 1.0 / (1.0 + damp + h * stiff)
    return Tustin(
        m11=scale * (1.0 + damp - h * stiff),
        m12=scale * 2.0 * h,
        m21=-scale * 2.0 * stiff,
        m22=scale * (1.0 - damp - h * stiff),
        n1=scale * h * stiff,
        n2=scale * stiff,
    )


def first_order_pb(p: float) -> tuple[float, float]:
    """P B with P = p and B = 1; -(P A + A' P) = 2 p / T must be positive."""
    if p <= 0.0:
        raise InputError(f"mrac.p = {p} gives no Lyapunov function", code="bad_mrac", key="mrac.p", hint="p > 0")
    return p, 0.0


def second_order_pb(p: float, settings: Settings) -> tuple[float, float]:
    """P B with B = [0, w^2] and P = p x shape; without a given shape that of -(P A + A' P) = p I.

    Raises InputError unless P and -(P A + A' P) are positive definite.
    """
    square, lean = settings.mrac_natural_radps * settings.mrac_natural_radps, 2.0 * settings.mrac_damping
    lean *= settings.mrac_natural_radps
    p12 = 0.5 / square
    p22 = (1.0 + 2.0 * p12) / (2.0 * lean)
    shape = settings.mrac_shape or (lean * p12 + square * p22, p12, p22)
    p11, p12, p22 = p * shape[0], p * shape[1], p * shape[2]
    n11, n12, n22 = 2.0 * square * p12, square * p22 + lean * p12 - p11, 2.0 * (lean * p22 - p12)
    if not (p11 > 0.0 and p11 * p22 > p12 * p12 and n11 > 0.0 and n11 * n22 > n12 * n12):
        raise InputError(
            f"P = [[{p11}, {p12}], [{p12}, {p22}]] gives no Lyapunov function of the reference model",
            code="bad_mrac",
            key="mrac_shape",
            hint="leave it out: it is then solved for",
        )
    return square * p12, square * p22


def init(params: MracParams, dt_s: float) -> MracState:
    return MracState(0.0, params.start, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@kernel
def step(
    params: MracParams, state: MracState, x: tuple[float, float, float], dt_s: float
) -> tuple[MracState, InnerAnswer]:
    """delta_mrac = Kx x + Kr r (eq. 6), all in percent."""
    wish_rad, measured_rad, speed_mps = x
    if params.enable == 0.0:
        return state, InnerAnswer(wish_rad, 0.0)
    command, angle = wish_rad * params.percent_per_rad, measured_rad * params.percent_per_rad
    if state.begun == 0.0:
        state = MracState(1.0, state.gains, angle, 0.0, angle, 0.0, command, 0.0, 0.0, 0.0, angle)
    rate = (angle - state.angle) / dt_s if params.order2 != 0.0 else 0.0
    largest = steer_bound(params.bound, speed_mps) * params.percent_per_rad
    if params.plain != 0.0:
        largest = 1e9
    ref1, ref2 = follow(params.reference, state, command)
    if params.plain == 0.0:
        ref1, _ = bounded(ref1, state.ref1, largest, dt_s)
    error1, error2 = angle - ref1 + state.windup1, rate - ref2 + state.windup2
    pull = beyond(error1, params.dead_zone) * (error1 * params.pb1 + error2 * params.pb2)
    gains = state.gains
    if abs(speed_mps) >= ADAPT_ABOVE_MPS:
        gains = adapt(params, state, angle, rate, command, pull, dt_s)
    free = gains.x1 * angle + gains.x2 * rate + gains.r * command
    out, status = free, 0.0
    if params.plain == 0.0:
        out, status = bounded(free, state.out, largest, dt_s)
    windup1, windup2 = 0.0, 0.0
    if status != 0.0:
        windup1 = params.anti_windup * (clamp(free, -largest, largest) - free)
        if params.order2 != 0.0:
            speed = (free - state.out) / dt_s
            windup2 = params.anti_windup * (clamp(speed, -RATE_PERCENT_PER_S, RATE_PERCENT_PER_S) - speed)
    answer = InnerAnswer(out / params.percent_per_rad, status)  # not 0: 100 over a finite limit
    return MracState(1.0, gains, ref1, ref2, angle, rate, command, pull, windup1, windup2, out), answer


@kernel
def beyond(error: float, dead_zone: float) -> float:
    """Share of an error above the dead zone: 0 within it, 1 far above or without a dead zone."""
    size = abs(error)
    if size <= dead_zone:
        return 1.0 if dead_zone == 0.0 else 0.0
    return (size - dead_zone) / size  # size > dead_zone >= 0


@kernel
def follow(model: Tustin, state: MracState, command: float) -> tuple[float, float]:
    """The reference model of eq. 5 a tick later."""
    drive = command + state.command
    ref1 = model.m11 * state.ref1 + model.m12 * state.ref2 + model.n1 * drive
    return ref1, model.m21 * state.ref1 + model.m22 * state.ref2 + model.n2 * drive


@kernel
def adapt(
    params: MracParams, state: MracState, angle: float, rate: float, command: float, pull: float, dt_s: float
) -> Gains:
    """Eq. 6: K' = -gamma phi (e' P B), trapezoidal (Euler in the paper's form), within the clamp or not at all."""
    last = state.gains
    if params.plain != 0.0:
        share = dt_s * params.gamma * pull
        return Gains(last.x1 - share * angle, last.x2 - share * rate, last.r - share * command)
    half = 0.5 * dt_s * params.gamma
    gains = Gains(
        last.x1 - half * (angle * pull + state.angle * state.pull),
        last.x2 - half * (rate * pull + state.rate * state.pull),
        last.r - half * (command * pull + state.command * state.pull),
    )
    # If either leaves its range both are reset. A reference slower than the assumed actuator starts outside: frozen.
    outside = gains.x1 > 0.0 or gains.x1 < params.x_low or gains.r < 1.0 or gains.r > params.r_high
    if params.clamped != 0.0 and outside:
        return last
    return gains


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
    lag_s, tau_s = setup.delays.steer_lag_s, actuator_tau_s(setup.vehicle)
    if setup.values["mrac.enable"] < 0.5 or tau_s <= 0.0 or setup.settings.mrac_form == "paper":
        return lag_s
    return lag_with_feedback_s(setup.delays, tau_s / setup.values["mrac.t_ref_s"])


def lag_with_feedback_s(delays: LoopDelays, command_gain: float) -> float:
    """The lag of u = (1 - r) angle + r command around an actuator: its slow signals are (dead time + lag) / r late.

    The measured angle comes one dead time late, so a gain r above 1 takes from the dead time too, and one below adds.
    """
    dead_s = delays.steer_dead_time_s + delays.bus_s
    return max((dead_s + delays.steer_lag_s) / command_gain - dead_s, 0.0)


CONTROLLER = Recipe(make, tunables_of("mrac."), loop_lag_s)
