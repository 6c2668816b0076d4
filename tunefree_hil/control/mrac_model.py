"""Reference models of MRAC (eq. 5 of the paper, order n) and the P B of their Lyapunov equation, at build time.

Order 1 has the time constant `mrac.t_ref_s`, order 2 the natural frequency and damping of Settings, both as Apollo has
them. From order 3 on the model is a lag of `mrac.t_ref_s` and n - 1 equal lags that together are as late as the dead
time of the data sheet: 1 / ((T s + 1) (e s + 1)^(n-1)), e = dead time / (n - 1). A product of equal lags is the usual
rational form of a dead time (it becomes one as n grows), so a higher order asks the wheel for an answer that it can
give, and T keeps its meaning. The start gains of the angle and the command are then those of order 1, and the gains of
its derivatives carry the measured angle ahead by the dead time.

n equal lags that are T late together would need larger start gains (order 3: 1.5 on the angle, 0.1 s on its rate), with
which the loop around the actuator of the data sheet swings up.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import buffer, table
from tunefree_hil.control.contract import RISE_PER_TAU, Settings, VehicleConstants
from tunefree_hil.control.riccati import solve

# Behind the data sheet's actuator (tests/control/inner/steering_loop.py, p = 1e-3) the wheel differs from the reference
# by 0.201 rad RMS with order 1, 0.075 with 3, 0.066 with 4 and 0.062 with 5, while the noise that a standing wheel puts
# on the command grows: 0.0004, 0.0033, 0.0045, 0.0055 rad. Above 4 there is little to gain.
LARGEST_ORDER = 4
LEAST_LAG_TICKS = 2.0  # of the lags for the dead time: a shorter one is not seen at this rate


class ReferenceModel(NamedTuple):
    """x[k] = m x[k-1] + n (r[k] + r[k-1]), m by rows; x[0] is the angle. Order 2: x[1] its rate; above: lags."""

    m: Any
    n: Any


class StartGains(NamedTuple):
    """u = sum of angle[i] x (i-th derivative of the angle, in the units of the model) + command x (the command)."""

    angle: tuple[float, ...]
    command: float


class SymmetricMatrix(NamedTuple):
    """Two rows and columns."""

    p11: float
    p12: float
    p22: float


def check_order(settings: Settings, vehicle: VehicleConstants, dt_s: float) -> None:
    """Raise InputError for an order or form that MRAC does not have, or an order too high for the dead time."""
    order, dead_s = settings.mrac_order, vehicle.steer_dead_time_s
    if not 1 <= order <= LARGEST_ORDER or settings.mrac_form not in ("apollo", "paper"):
        raise InputError(
            f"mrac_order is 1 to {LARGEST_ORDER}, mrac_form 'apollo' or 'paper'",
            code="bad_mrac",
            key="controller.mrac_order",
        )
    if order < 3:
        return
    if settings.mrac_shape is not None:
        raise InputError("mrac_shape is for order 2", code="bad_mrac", key="mrac_shape", hint="leave it out")
    if dead_s < (order - 1) * LEAST_LAG_TICKS * dt_s:
        raise InputError(
            f"mrac_order {order} models the steering's dead time as {order - 1} lags, and {dead_s:g} s is too short",
            code="bad_mrac",
            key="controller.mrac_order",
            hint="take a lower order (1 needs no dead time), or write [latency.steer] dead_time_s into vehicle.toml",
        )


def actuator_tau_s(vehicle: VehicleConstants) -> float:
    """The lag for the dead time and rise time of the data sheet (MKZ: 0.1227 s)."""
    return (vehicle.steer_dead_time_s + vehicle.steer_rise_time_s) / RISE_PER_TAU


def dead_time_lag_s(settings: Settings, vehicle: VehicleConstants) -> float:
    """Each of the n - 1 equal lags for the dead time, n >= 3."""
    return vehicle.steer_dead_time_s / (settings.mrac_order - 1)


def time_unit_s(t_ref_s: float, settings: Settings, vehicle: VehicleConstants) -> float:
    """The unit of time of derivatives: the geometric mean of the model's lags; 1 s for orders 1 and 2.

    In it the last coefficient of the model is 1 and derivatives are as large as the angle, so `mrac.p` has one scale.
    """
    order = settings.mrac_order
    if order < 3:
        return 1.0
    lag_s = dead_time_lag_s(settings, vehicle)
    return math.exp((math.log(t_ref_s) + (order - 1) * math.log(lag_s)) / order)


def start_gains(t_ref_s: float, vehicle: VehicleConstants, settings: Settings) -> StartGains:
    """Gains with which the assumed actuator is the reference model; 1 on the command alone in the paper's form."""
    order = settings.mrac_order
    if settings.mrac_form == "paper" or vehicle.steer_rise_time_s <= 0.0:
        return StartGains((0.0,) * order, 1.0)
    if order == 2:
        # Natural frequency 1.8 / rise time; damping 1 without a settling time.
        natural = 1.8 / vehicle.steer_rise_time_s
        square = natural * natural
        wish, damping = settings.mrac_natural_radps, settings.mrac_damping
        gains = (1.0 - wish * wish / square, 2.0 * (natural - damping * wish) / square)
        return StartGains(gains, wish * wish / square)
    ratio, unit_s = actuator_tau_s(vehicle) / t_ref_s, time_unit_s(t_ref_s, settings, vehicle)
    return StartGains(tuple((1.0 - ratio) * share for share in lead_shares(settings, vehicle, unit_s)), ratio)


def lead_shares(settings: Settings, vehicle: VehicleConstants, unit_s: float) -> tuple[float, ...]:
    """Coefficients of (e s + 1)^(n-1), ascending: the gains on the derivatives over that on the angle. (1,) at order 1.

    (tau s + 1) (e s + 1)^(n-1) angle = u becomes the reference model with u = [(1 - tau/T) (e s + 1)^(n-1)] angle
    + tau/T command.
    """
    lags = settings.mrac_order - 1
    if lags == 0:
        return (1.0,)
    lag = dead_time_lag_s(settings, vehicle) / unit_s
    return tuple(math.comb(lags, i) * math.prod([lag] * i) for i in range(lags + 1))


def require_time_constant(t_ref_s: float) -> None:
    """Raise InputError for a time constant that is not positive."""
    if t_ref_s <= 0.0:
        raise InputError(
            f"mrac.t_ref_s = {t_ref_s} is no time constant", code="bad_mrac", key="mrac.t_ref_s", hint="give it above 0"
        )


def reference_model(t_ref_s: float, settings: Settings, vehicle: VehicleConstants, dt_s: float) -> ReferenceModel:
    """The model of the order of Settings, by Tustin's rule. Raises InputError for a time constant that is none."""
    if settings.mrac_order == 2:
        return second_order(settings, dt_s)
    require_time_constant(t_ref_s)
    if settings.mrac_order == 1:
        half = 0.5 * dt_s / t_ref_s
        return ReferenceModel(table([(1.0 - half) / (1.0 + half)]), table([half / (1.0 + half)]))
    lags = settings.mrac_order - 1
    return lag_chain([dead_time_lag_s(settings, vehicle)] * lags + [t_ref_s], dt_s)


def second_order(settings: Settings, dt_s: float) -> ReferenceModel:
    """A = [[0, 1], [-w^2, -2 d w]], B = [0, w^2]: (I - h A)^-1 (I + h A) and (I - h A)^-1 h B with h = dt/2."""
    h, w, d = 0.5 * dt_s, settings.mrac_natural_radps, settings.mrac_damping
    stiff, damp = h * w * w, 2.0 * h * d * w
    scale = 1.0 / (1.0 + damp + h * stiff)
    m11, m12 = scale * (1.0 + damp - h * stiff), scale * 2.0 * h
    m21, m22 = -scale * 2.0 * stiff, scale * (1.0 - damp - h * stiff)
    return ReferenceModel(table([m11, m12, m21, m22]), table([scale * h * stiff, scale * stiff]))


def lag_chain(lags_s: list[float], dt_s: float) -> ReferenceModel:
    """Lags in a row, the last one driven by the command: lag x[i]' = x[i + 1] - x[i]."""
    order = len(lags_s)
    minus, plus, drive = buffer(order * order), buffer(order * order), buffer(order)
    for i, lag_s in enumerate(lags_s):
        half = 0.5 * dt_s / lag_s
        minus[i * order + i], plus[i * order + i] = 1.0 + half, 1.0 - half
        if i + 1 < order:
            minus[i * order + i + 1], plus[i * order + i + 1] = -half, half
    drive[order - 1] = 0.5 * dt_s / lags_s[-1]
    again = buffer(order * order)
    for i in range(order * order):
        again[i] = minus[i]  # `solve` overwrites the matrix, which is needed twice
    solve(minus, plus, order, order)
    solve(again, drive, order, 1)
    return ReferenceModel(table(plus), table(drive))


def lyapunov_pb(t_ref_s: float, p: float, settings: Settings, vehicle: VehicleConstants) -> tuple[float, ...]:
    """P B of the order of Settings. Raises InputError unless it is of a Lyapunov function of the reference model."""
    if settings.mrac_order == 2:
        return second_order_pb(p, settings)
    if p <= 0.0:
        raise InputError(f"mrac.p = {p} gives no Lyapunov function", code="bad_mrac", key="mrac.p", hint="p > 0")
    if settings.mrac_order == 1:
        return (p,)  # P = p and B = 1; -(P A + A' P) = 2 p / T
    coefficients = model_coefficients(t_ref_s, settings, vehicle)
    return tuple(p * entry for entry in last_column(coefficients))


def model_coefficients(t_ref_s: float, settings: Settings, vehicle: VehicleConstants) -> tuple[float, ...]:
    """a[0] = 1 to a[n-1] of s^n + a[n-1] s^(n-1) + ... + a[0], the model's polynomial in its unit of time, n >= 3."""
    unit_s = time_unit_s(t_ref_s, settings, vehicle)
    lag = t_ref_s / unit_s
    shares = (*lead_shares(settings, vehicle, unit_s), 0.0)
    return (1.0, *(shares[i] + lag * shares[i - 1] for i in range(1, settings.mrac_order)))


def last_column(coefficients: tuple[float, ...]) -> list[float]:
    """The last column of P with A' P + P A = -2 I for the companion matrix A of a stable polynomial with a[0] = 1.

    It is P B for B = [0, ..., 0, 1]. Its first entry is 1 at every order, so p weighs the error of the angle alike.
    """
    order = len(coefficients)
    size = order * order
    a = [[1.0 if j == i + 1 else 0.0 for j in range(order)] for i in range(order)]
    a[-1] = [-value for value in coefficients]
    matrix, right = buffer(size * size), buffer(size)
    for i in range(order):
        for j in range(order):
            row = (i * order + j) * size
            for k in range(order):
                matrix[row + k * order + j] += a[k][i]
                matrix[row + i * order + k] += a[k][j]
        right[i * order + i] = -2.0
    solve(matrix, right, size, 1)
    return [float(right[i * order + order - 1]) for i in range(order)]


def second_order_pb(p: float, settings: Settings) -> tuple[float, float]:
    """P B with B = [0, w^2] and P = p x shape; without a given shape that of -(P A + A' P) = p I.

    Raises InputError unless P and -(P A + A' P) are positive definite.
    """
    square, lean = settings.mrac_natural_radps * settings.mrac_natural_radps, 2.0 * settings.mrac_damping
    lean *= settings.mrac_natural_radps
    p11, p12, p22 = second_order_p(p, settings)
    n11, n12, n22 = 2.0 * square * p12, square * p22 + lean * p12 - p11, 2.0 * (lean * p22 - p12)
    if not (p11 > 0.0 and p11 * p22 > p12 * p12 and n11 > 0.0 and n11 * n22 > n12 * n12):
        raise InputError(
            f"P = [[{p11}, {p12}], [{p12}, {p22}]] gives no Lyapunov function of the reference model",
            code="bad_mrac",
            key="mrac_shape",
            hint="leave it out: it is then solved for",
        )
    return square * p12, square * p22


def second_order_p(p: float, settings: Settings) -> SymmetricMatrix:
    """P of order 2, which `second_order_pb` checks."""
    square, lean = settings.mrac_natural_radps * settings.mrac_natural_radps, 2.0 * settings.mrac_damping
    lean *= settings.mrac_natural_radps
    p12 = 0.5 / square
    p22 = (1.0 + 2.0 * p12) / (2.0 * lean)
    p11, p12, p22 = settings.mrac_shape or (lean * p12 + square * p22, p12, p22)
    return SymmetricMatrix(p * p11, p * p12, p * p22)
