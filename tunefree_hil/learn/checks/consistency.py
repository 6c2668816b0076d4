"""What signals of a drive say of each other: units, signs, pedals, and signals that stand still (learn/checks/drive_checks.py)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from tunefree_hil.config.import_schema import si_unit
from tunefree_hil.episode.plausible import HIGHEST, HIGHEST_OF, Finding, check_units
from tunefree_hil.episode.plausible_pairs import Pair, pairs_of
from tunefree_hil.learn.checks.problem import Problem
from tunefree_hil.learn.checks.stuck_signals import check_stuck
from tunefree_hil.learn.drives.drive import (
    BRAKES,
    CHASSIS_FIRST_SPEEDS,
    THROTTLES,
    TURNS,
    Drive,
    as_columns,
    backwards,
    first_of,
    moving,
    name_of,
)
from tunefree_hil.learn.drives.smoothing import between_fresh

if TYPE_CHECKING:
    from tunefree_hil.config.schema import NominalSpec, VehicleSpec

Array = np.ndarray

STEERING = "steer_and_yaw_rate"
# Of an unknown vehicle, only for the sign: a wheelbase in m and a steering ratio between a scale model's and a van's.
STAND_IN = (1.0, 40.0)
LEAST_TURNED = 0.05  # of the greatest angle: a wheel that is not centred may be turned the other way by less
ONLY_TOLD = ("accel_and_speed",)  # a hill is in the one and not in the other
PRESSED_FRAC, LET_GO_FRAC = 0.03, 0.01
DELAY_S, WINDOW_S = 0.1, 0.5  # a pedal's effect is looked for from here on, over so long
# A steering moves as its command where it goes at least WHOLE_MOVE of its way within MOVE_S, of the moves that are as
# large as CLEAR_MOVE of the largest; for so long, and in such a share of them, no chance does it
STEER = "report.steer_rad"
MOVE_S, CLEAR_MOVE, WHOLE_MOVE, LEAST_OBEYED_S, OBEYED_SHARE = 0.1, 0.3, 0.67, 0.5, 0.05
INSIDE, CLEAR_ANGLE, LEAST_INSIDE_S = 0.7, 0.2, 2.0  # of the largest angle that is reached; for so long in all
LEAST_PRESSED_S, LEAST_APART_MPS2 = 1.0, 0.2
LEAST_ACCEL_MPS2, LEAST_MOVED_FRAC, TURNED_FIT = 0.2, 0.03, -0.5  # standard deviations; a correlation


def check_motion(drive: Drive, vehicle: VehicleSpec) -> Iterator[Problem]:
    """All of them for one drive. What hardly moves is not judged."""
    yield from _ranges(drive)
    yield from _pairs(drive, vehicle.nominal, vehicle.limits.steer_rad)
    yield from _pedals(drive, vehicle.nominal.rest_pedal_frac)
    yield from _accel_command(drive)
    yield from check_stuck(drive)


def _ranges(drive: Drive) -> Iterator[Problem]:
    """Values that no car shows: a unit that is not what vehicle.toml says."""
    for name, values in drive.fields.items():
        field = name.partition(".")[2]
        highest = HIGHEST_OF.get(field, HIGHEST.get(si_unit(field)))
        some = np.abs(values[drive.fresh[name] & np.isfinite(values)])
        if highest is not None and some.size and some.max() > highest:
            words = (
                f"{drive.path}: {name} reaches {some.max():.4g}, where at most {highest:g} is expected; is its unit or "
            )
            yield Problem("refuse", "units", drive.name, name, words + "scale in vehicle.toml wrong?")


def _findings(drive: Drive, nominal: NominalSpec, most_rad: float) -> Iterator[tuple[Pair, Finding, dict[str, str]]]:
    """(what was compared, what came of it, fields that stood in for others) of all that could be judged."""
    steer = name_of(drive, TURNS)
    instead = {"report.steer_rad": steer} if steer and "report.steer_rad" not in drive.fields else {}
    columns = as_columns(drive, instead)
    known = bool(nominal.wheelbase_m and nominal.steer_ratio)
    length_m, ratio = (nominal.wheelbase_m, nominal.steer_ratio) if known else STAND_IN
    constants = (length_m, ratio, nominal.wheel_radius_m)
    pairs = [one for one in pairs_of(*constants) if all(name in columns.columns for name in (*one.first, *one.second))]
    found = [one for one in check_units(columns, *constants) if one.check != "range"]
    for pair, finding in zip(pairs, found, strict=True):
        if (
            finding.holds is None
            or finding.factor is None
            or {*pair.first, *pair.second} <= {*instead, *instead.values()}
        ):
            continue
        if (
            pair.check == STEERING and not known
        ):  # its size says nothing, and next to straight ahead not its sign either
            if np.ptp(drive.fields[steer or "report.steer_rad"][moving(drive)]) < LEAST_TURNED * most_rad:
                continue
            finding = finding._replace(holds=finding.factor > 0.0)
        yield pair, finding, instead


def _pairs(drive: Drive, nominal: NominalSpec, most_rad: float) -> Iterator[Problem]:
    """Fields that say the same thing twice and do not say the same. most_rad: the greatest steering angle."""
    for pair, finding, instead in _findings(drive, nominal, most_rad):
        factor = finding.factor
        if finding.holds or factor is None:
            continue
        first, second = (" and ".join(instead.get(name, name) for name in some) for some in (pair.first, pair.second))
        severity = "warn" if pair.check in ONLY_TOLD else "refuse"
        field = instead.get(pair.first[0], pair.first[0])
        if factor < 0.0:
            words = (
                f"{drive.path}: {second} goes the other way than {first} (factor {factor:.2f}), where the same way is "
            )
            words += "expected (ISO 8855: left and forward positive); turn the sign of one of them in vehicle.toml"
            code = "steer_sign" if "steer" in first else "wrong_sign"
            yield Problem(severity, code, drive.name, field, words)
        else:
            low, high = pair.allowed
            words = f"{drive.path}: {second} is {factor:.3g} times what {first} makes one expect (allowed {low:.2g} to "
            words += f"{high:.2g}); is a unit or scale in vehicle.toml wrong, or this the log of another vehicle?"
            # a unit is wrong by as much everywhere; a wheel that stops before its command does may be the car itself
            short = not instead and pair.second == (STEER,) and factor < low and _obeys_somewhere(drive, pair.first[0])
            yield Problem(severity, "short_of_command" if short else "units", drive.name, field, words)


def _obeys_somewhere(drive: Drive, command: str) -> bool:
    """Whether the reported steering goes about as far as its command does for some time: it stops, it is slow, or it
    has play, where a wrong unit makes every move too small, and every angle.
    """
    asked, said = (between_fresh(drive.fields[name], drive.fresh[name]) for name in (command, STEER))
    delay, window = round(DELAY_S / drive.dt_s), max(1, round(MOVE_S / drive.dt_s))
    if drive.ticks <= 2 * (delay + window):
        return False
    moved = (asked[window:] - asked[:-window])[: -delay or None]
    went = (said[window:] - said[:-window])[delay:]
    clear = np.abs(moved) > CLEAR_MOVE * np.nanmax(np.abs(moved), initial=0.0)
    whole = went[clear] / moved[clear] > WHOLE_MOVE
    moves = bool(whole.sum() * drive.dt_s > LEAST_OBEYED_S and whole.mean() > OBEYED_SHARE)
    return moves or _reaches_small_angles(asked[: -delay or None], said[delay:], drive.dt_s)


def _reaches_small_angles(asked: Array, said: Array, dt_s: float) -> bool:
    """Whether angles far inside of what is reached are about those that were asked for: a wheel that most of its
    commands pass, makes few whole moves.
    """
    reached = np.nanmax(np.abs(said), initial=0.0)
    inside = np.isfinite(said) & (np.abs(asked) < INSIDE * reached) & (np.abs(asked) > CLEAR_ANGLE * reached)
    if inside.sum() * dt_s <= LEAST_INSIDE_S:
        return False
    return float(np.median(said[inside] / asked[inside])) > WHOLE_MOVE


def _pedals(drive: Drive, rest_frac: float) -> Iterator[Problem]:
    """Whether the throttle speeds it up and the brake slows it down, by every source of both."""
    accel = _following_accel(drive)
    if accel is None:
        return
    for throttle_name, brake_name in zip(THROTTLES, BRAKES, strict=True):
        throttle, brake = drive.get(throttle_name), drive.get(brake_name)
        rows = _judged(drive, accel, by_command=throttle_name.startswith("command."))
        if throttle is None:
            continue
        if brake is None:
            yield from _one_pedal(drive, throttle_name, throttle, accel, rows)
            continue
        driven = (throttle > rest_frac + PRESSED_FRAC) & (brake < rest_frac + LET_GO_FRAC)
        braked = (brake > rest_frac + PRESSED_FRAC) & (throttle < rest_frac + LET_GO_FRAC)
        driven, braked = rows & _kept(driven, drive.dt_s), rows & _kept(braked, drive.dt_s)
        if min(driven.sum(), braked.sum()) * drive.dt_s < LEAST_PRESSED_S:
            continue
        by_throttle, by_brake = float(accel[driven].mean()), float(accel[braked].mean())
        if by_throttle < by_brake - LEAST_APART_MPS2:
            words = (
                f"{drive.path}: with {throttle_name} pressed the speed changes by {by_throttle:+.2f} m/s^2 and with "
            )
            words += (
                f"{brake_name} by {by_brake:+.2f} m/s^2, where the throttle is expected to speed up: swapped pedals; "
            )
            yield Problem("refuse", "swapped_pedals", drive.name, throttle_name, words + "swap them in vehicle.toml")


def _one_pedal(drive: Drive, name: str, throttle: Array, accel: Array, rows: Array) -> Iterator[Problem]:
    """A vehicle without a brake: more throttle must not mean slowing down."""
    if rows.sum() * drive.dt_s < LEAST_PRESSED_S or np.std(throttle[rows]) < LEAST_MOVED_FRAC:
        return
    if np.std(accel[rows]) > LEAST_ACCEL_MPS2 and (fit := _correlation(throttle[rows], accel[rows])) < TURNED_FIT:
        words = (
            f"{drive.path}: the speed falls when {name} rises (correlation {fit:.2f}), where it is expected to rise; "
        )
        yield Problem(
            "refuse", "swapped_pedals", drive.name, name, words + "is it the brake, or its sign turned round?"
        )


def _accel_command(drive: Drive) -> Iterator[Problem]:
    """Whether an acceleration that is asked for is one in the same direction."""
    name, accel = "command.accel_mps2", _following_accel(drive)
    asked = drive.get(name)
    if asked is None or accel is None:
        return
    rows = _judged(drive, accel, by_command=True) & np.isfinite(asked)
    if rows.sum() * drive.dt_s < LEAST_PRESSED_S or min(np.std(asked[rows]), np.std(accel[rows])) < LEAST_ACCEL_MPS2:
        return
    if (fit := _correlation(asked[rows], accel[rows])) < TURNED_FIT:
        words = (
            f"{drive.path}: the speed falls when {name} rises (correlation {fit:.2f}), where it is expected to rise; "
        )
        yield Problem("refuse", "swapped_pedals", drive.name, name, words + "turn its sign in vehicle.toml")


def _following_accel(drive: Drive) -> Array | None:
    """The speed's rate over WINDOW_S, from DELAY_S after each row; NaN at the end. None without a speed."""
    speed = first_of(drive, CHASSIS_FIRST_SPEEDS)
    if speed is None:
        return None
    delay, window = round(DELAY_S / drive.dt_s), max(1, round(WINDOW_S / drive.dt_s))
    rate = np.full(drive.ticks, np.nan)
    rows = max(0, drive.ticks - delay - window)
    rate[:rows] = (speed[delay + window :][:rows] - speed[delay:][:rows]) / (window * drive.dt_s)
    return rate


def _kept(pressed: Array, dt_s: float) -> Array:
    """Rows from which on it stays pressed as long as its effect is looked at: a pedal that is soon changed for the
    other one has the other one's effect.
    """
    rows = round(DELAY_S / dt_s) + max(1, round(WINDOW_S / dt_s))
    count = np.concatenate(([0], np.cumsum(pressed)))
    kept = np.zeros(len(pressed), dtype=bool)
    kept[: max(0, len(pressed) - rows)] = count[rows + 1 :] - count[: -rows - 1] == rows + 1
    return kept


def _judged(drive: Drive, accel: Array, *, by_command: bool) -> Array:
    rows = moving(drive) & ~backwards(drive) & np.isfinite(accel)
    return rows & drive.enabled if by_command else rows


def _correlation(a: Array, b: Array) -> float:
    a, b = a - a.mean(), b - b.mean()
    squares = float(a @ a) * float(b @ b)
    return float(a @ b) / squares**0.5 if squares > 0.0 else 0.0
