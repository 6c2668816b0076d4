"""MRAC of the steering actuator that stays put when there is nothing to learn, and does not blame the dead time.

The law is that of mrac.py (eq. 5 and 6, reference model of order 1, everything in percent of the steering limit). What
is changed are remedies of the literature (Ioannou and Sun, Robust Adaptive Control, 1996, chapters 4 and 8):

- hedging of the dead time: the measured angle is compared with the reference model as it was one dead time ago, and
  the gains are adapted with the signals of then, as they made the angle of now;
- normalised gradient: the step is divided by 1 + the signals' squared size, so it does not grow with the manoeuvre;
- sigma-modification: the gains leak back to the start gains at `mrac.leak_1ps`;
- projection: each gain stays within a share `mrac.reach` of the start gains, and goes on along the bound;
- no adaptation while the command is at a bound, or the demand moves too little to tell a gain from an offset.

The start gains come from the identified lag, not from dead time and rise time taken together.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from tunefree_hil.base.contracts import Block, Tunable
from tunefree_hil.base.kernel import buffer, kernel
from tunefree_hil.base.maths import clamp
from tunefree_hil.control.contract import InnerAnswer, Recipe, Setup
from tunefree_hil.control.inner.mrac import ADAPT_ABOVE_MPS, beyond, bounded, lag_with_feedback_s
from tunefree_hil.control.limits import SteerBound, steer_bound, steer_bound_of
from tunefree_hil.control.mrac_model import require_time_constant
from tunefree_hil.control.mrac_needs import require_first_order, require_needs
from tunefree_hil.control.parameters import tunables_of

# Normalised gradient: the published box of mrac.p, 1e-4 to 0.1, adapts in 250 s to 0.25 s. With 0.1 s, as long as a
# dead time, the gains follow their own delay and the wheel swings (24 of 250 drawn sets; none with 0.25 s).
RATE_PER_P_1PS = 40.0
LEAST_PERCENT = 0.5  # smaller demands, in percent of the limit, are not learned from


class MracRobustParams(NamedTuple):
    """Everything in percent. enable: 0 or 1; delay_ticks: of the hedging."""

    enable: float
    percent_per_rad: float
    model_share: float  # of the way to the command that the reference model goes in a tick
    rate_1ps: float
    leak_1ps: float
    dead_zone: float
    start_angle: float
    start_command: float
    reach: float
    delay_ticks: int
    bound: SteerBound


class MracRobustState(NamedTuple):
    """Gains, reference model, and what has not reached the wheel yet: rings of reference, angle and command."""

    begun: float
    angle_gain: float
    command_gain: float
    reference: float
    references: Any
    angles: Any
    commands: Any
    place: int
    out: float


def make(setup: Setup) -> Block:
    """x = (steer demand rad, measured steer rad, speed m/s) -> InnerAnswer; with mrac.enable = 0 the demand itself.

    Raises InputError for a vehicle without its needs (control/mrac_needs.py), and for a time constant that is not one.
    """
    values, vehicle, delays = setup.values, setup.vehicle, setup.delays
    enable = 1.0 if values["mrac.enable"] >= 0.5 else 0.0
    if enable:
        require_needs(setup, delays.steer_lag_s)
        require_first_order(setup)
    t_ref_s = values["mrac.t_ref_s"]
    require_time_constant(t_ref_s)
    ratio = delays.steer_lag_s / t_ref_s
    params = MracRobustParams(
        enable=enable,
        percent_per_rad=100.0 / vehicle.steer_limit_rad,
        model_share=setup.dt_s / (t_ref_s + setup.dt_s),
        rate_1ps=RATE_PER_P_1PS * values["mrac.p"] * values["mrac.gamma"],
        leak_1ps=values["mrac.leak_1ps"],
        dead_zone=setup.settings.mrac_dead_zone,
        start_angle=1.0 - ratio,
        start_command=ratio,
        reach=values["mrac.reach"],
        delay_ticks=round((delays.steer_dead_time_s + delays.bus_s) / setup.dt_s),
        bound=steer_bound_of(setup),
    )
    return Block(init, step, params, CONTROLLER.tunables)


def init(params: MracRobustParams, dt_s: float) -> MracRobustState:
    """The start gains, nothing under way."""
    length = params.delay_ticks + 1
    rings = (buffer(length), buffer(length), buffer(length))
    return MracRobustState(0.0, params.start_angle, params.start_command, 0.0, *rings, 0, 0.0)


@kernel
def step(
    params: MracRobustParams, state: MracRobustState, x: tuple[float, float, float], dt_s: float
) -> tuple[MracRobustState, InnerAnswer]:
    """delta_mrac = Kx x + Kr r (eq. 6), all in percent."""
    wish_rad, measured_rad, speed_mps = x
    if params.enable == 0.0:
        return state, InnerAnswer(wish_rad, 0.0)
    command, angle = wish_rad * params.percent_per_rad, measured_rad * params.percent_per_rad
    reference = state.reference
    if state.begun == 0.0:
        reference = angle
        for i in range(len(state.angles)):
            state.references[i], state.angles[i], state.commands[i] = angle, angle, command
    reference += params.model_share * (command - reference)
    place = state.place
    state.references[place], state.angles[place], state.commands[place] = reference, angle, command
    place += 1
    if place == len(state.angles):
        place = 0
    largest = steer_bound(params.bound, speed_mps) * params.percent_per_rad
    free = state.angle_gain * angle + state.command_gain * command
    out, status = bounded(free, state.out if state.begun != 0.0 else angle, largest, dt_s)
    angle_gain, command_gain = state.angle_gain, state.command_gain
    if status == 0.0 and abs(speed_mps) >= ADAPT_ABOVE_MPS:
        angle_gain, command_gain = adapt_gains(params, state, place, angle, dt_s)
    new_state = MracRobustState(
        1.0, angle_gain, command_gain, reference, state.references, state.angles, state.commands, place, out
    )
    return new_state, InnerAnswer(out / params.percent_per_rad, status)  # not 0: 100 over a finite limit


@kernel
def adapt_gains(
    params: MracRobustParams, state: MracRobustState, oldest: int, angle: float, dt_s: float
) -> tuple[float, float]:
    """(gain on the angle, gain on the command) a tick later, from the signals of one dead time ago."""
    angle_gain, command_gain = state.angle_gain, state.command_gain
    error = angle - float(state.references[oldest])
    then_angle, then_command = float(state.angles[oldest]), float(state.commands[oldest])
    if abs(then_command) >= LEAST_PERCENT:
        size = 1.0 + then_angle * then_angle + then_command * then_command
        pull = params.rate_1ps * beyond(error, params.dead_zone) * error / size  # not 0: 1 and squares
        angle_gain -= dt_s * pull * then_angle
        command_gain -= dt_s * pull * then_command
    angle_gain -= dt_s * params.leak_1ps * (angle_gain - params.start_angle)
    command_gain -= dt_s * params.leak_1ps * (command_gain - params.start_command)
    angle_gain = clamp(angle_gain, params.start_angle - params.reach, params.start_angle + params.reach)
    command_gain = clamp(command_gain, params.start_command - params.reach, params.start_command + params.reach)
    return angle_gain, command_gain


OWN = (
    Tunable("mrac.leak_1ps", "1/s", 0.0, 0.2, "linear"),
    Tunable("mrac.reach", "1", 0.0, 1.0, "linear"),
)


def loop_lag_s(setup: Setup) -> float:
    """The lag from the demand to the wheel with the start gains."""
    if setup.values["mrac.enable"] < 0.5:
        return setup.delays.steer_lag_s
    return lag_with_feedback_s(setup.delays, setup.delays.steer_lag_s / setup.values["mrac.t_ref_s"])


CONTROLLER = Recipe(make, tunables_of("mrac.") + OWN, loop_lag_s)
