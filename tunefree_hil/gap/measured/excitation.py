"""How much a drive excites each effect, in the quantities that effects name (base/contracts.py); and whether logs are
long enough, with enough driving.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.contracts import QUANTITIES, Effect
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GEAR_DRIVE
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.gap.measured.blocks import BLOCK_CRITERIA, GUARD_SHARE, Blocks, block_length_s, cut_blocks
from tunefree_hil.gap.measured.chain import MeasuredDrive
from tunefree_hil.gap.measured.observability import OUTPUT_FIELDS
from tunefree_hil.gap.measured.targets import TARGET_CRITERIA
from tunefree_hil.gap.model.graph import CHANNELS
from tunefree_hil.gap.selection.reasons import Criterion, Reason
from tunefree_hil.learn.drives.runs import find_runs

Array = np.ndarray


class ExcitationCriteria(NamedTuple):
    """How the quantities are measured; a pedal's numbers are duty (docs/results/criteria.md)."""

    min_moving_mps: float = 2.0  # speed, scaled to that of a road car, from which on moves are counted
    move_window_s: float = 0.5  # within which a command's move has to happen
    min_pedal_move: float = 0.03  # change of a command that counts as a move
    min_steer_move: float = 0.02  # the same of steering, of the steering limit
    min_steer_turn: float = 0.01  # of the steering limit, back from the last extreme
    max_straight_mps2: float = 0.3  # lateral acceleration below which a car drives straight
    min_curve_mps2: float = 0.5  # lateral acceleration above which it turns
    min_braking_mps: float = 3.0  # loss of speed from which on a braking counts
    min_pedal: float = 0.005  # above rest, from which on a pedal is pressed


class DrivingCriteria(NamedTuple):
    """When logs suffice."""

    # length of min_blocks blocks of the shortest length, with their guards
    min_log_s: float = BLOCK_CRITERIA.min_blocks * BLOCK_CRITERIA.min_block_s * (1.0 + GUARD_SHARE)
    min_named_share: float = 0.05  # of the time, from which on a cause of not driving is named


EXCITATION_CRITERIA, DRIVING_CRITERIA = ExcitationCriteria(), DrivingCriteria()
CURVE, LEFT, RIGHT = "curve_s", "left_s", "right_s"  # one drive may have the left curves, another the right ones
STANDING, GEAR = "standing", "gear"  # keys of the time in which the car does not drive; others are silent signals
SUMMED = {name for name in QUANTITIES if name.endswith(("_s", "_moves", "_reversals")) or name == "brakings"}


class Shortage(NamedTuple):
    """What drives lack of a quantity that an effect needs (base/contracts.py QUANTITIES), in its unit."""

    quantity: str
    available: float
    least: float

    @property
    def text(self) -> str:
        """As the answer lists it."""
        return f"{self.available:.3g} {QUANTITIES[self.quantity]}, {self.least:g} are needed"


class Excitation(NamedTuple):
    """How much drives excite an effect.

    Args:
        score: the least share of what the effect needs (1: just enough).
        is_sufficient: whether all that it needs is there.
        shortages: what is missing.
    """

    score: float
    is_sufficient: bool
    shortages: tuple[Shortage, ...]


def assess_excitation(effects: Mapping[str, Effect], available: Mapping[str, float]) -> dict[str, Excitation]:
    """The excitation of each effect; that of one without needs is always sufficient.

    available: each of QUANTITIES, from measure_quantities.
    """
    excitations = {}
    for name, effect in effects.items():
        shares = {need.quantity: available[need.quantity] / need.least for need in effect.needs if need.least > 0.0}
        least = {need.quantity: need.least for need in effect.needs}
        shortages = tuple(
            Shortage(quantity, available[quantity], least[quantity])
            for quantity, share in shares.items()
            if share < 1.0
        )
        score = min(shares.values(), default=1.0)
        excitations[name] = Excitation(float(score), not shortages, shortages)
    return excitations


def measure_quantities(drives: Sequence[MeasuredDrive], vehicle: VehicleSpec) -> dict[str, float]:
    """Each of QUANTITIES over all drives.

    Times and counts are summed, of curves each side by itself; spans and greatest values are the most of any drive.
    """
    parts = [_measure_drive(drive, vehicle) for drive in drives]
    quantities = {
        name: (sum if name in SUMMED else max)(part[name] for part in parts) for name in QUANTITIES if name != CURVE
    }
    return {**quantities, CURVE: min(sum(part[side] for part in parts) for side in (LEFT, RIGHT))}


def _measure_drive(drive: MeasuredDrive, vehicle: VehicleSpec) -> dict[str, float]:
    c, x, dt_s, rest = EXCITATION_CRITERIA, drive.inputs, drive.dt_s, vehicle.nominal.rest_pedal_frac
    limit = max(vehicle.limits.steer_rad, 1e-6)
    throttle, brake, steer = x.commands[:, 0], x.commands[:, 1], x.commands[:, 2] / limit
    speed, window = x.speed_mps / drive.size_scale, max(round(c.move_window_s / dt_s), 1)
    is_moving = drive.is_moving & (speed > c.min_moving_mps)
    lateral = speed * x.yaw_rate_radps  # of a model car as of a road car that drives alike
    is_coasting = (throttle < rest + c.min_pedal) & (brake < rest + c.min_pedal)
    measure: dict[str, Callable[[], float]] = {
        "moving_s": lambda: dt_s * is_moving.sum(),
        "top_speed_mps": lambda: float(speed[drive.is_moving].max(initial=0.0)),
        "speed_span_mps": lambda: _span(speed[is_moving]),
        "straight_s": lambda: dt_s * (is_moving & (abs(lateral) < c.max_straight_mps2)).sum(),
        LEFT: lambda: dt_s * (is_moving & (lateral > c.min_curve_mps2)).sum(),
        RIGHT: lambda: dt_s * (is_moving & (lateral < -c.min_curve_mps2)).sum(),
        "lateral_accel_mps2": lambda: float(drive.size_scale * abs(lateral[is_moving]).max(initial=0.0)),
        "steer_moves": lambda: _count_moves(steer, c.min_steer_move, window),
        "steer_reversals": lambda: _count_reversals(steer, c.min_steer_turn),
        "steer_span_frac": lambda: _span(steer),
        "throttle_moves": lambda: _count_moves(throttle, c.min_pedal_move, window),
        "throttle_span_frac": lambda: _span(throttle),
        "throttle_s": lambda: dt_s * (throttle > rest + c.min_pedal).sum(),
        "brake_moves": lambda: _count_moves(brake, c.min_pedal_move, window),
        "brake_span_frac": lambda: _span(brake),
        "brakings": lambda: _count_brakings(brake > rest + c.min_pedal, speed),
        "coast_s": lambda: dt_s * (is_moving & is_coasting).sum(),
    }
    return {name: float(value()) for name, value in measure.items()}


def _span(values: Array) -> float:
    return float(np.ptp(values)) if len(values) else 0.0


def _count_moves(values: Array, step: float, window: int) -> float:
    """Separate changes by a step within so many rows."""
    if len(values) <= window:
        return 0.0
    is_large = np.abs(values[window:] - values[:-window]) >= step
    return float(len(find_runs(is_large, 1)))


def _count_reversals(values: Array, turn: float) -> float:
    """How often a signal comes back by `turn` from its last extreme."""
    count, direction, extreme = 0, 0, values[0] if len(values) else 0.0
    for value in values[::2].tolist():
        if direction * (value - extreme) > 0.0 or direction == 0:
            if direction == 0 and abs(value - extreme) > turn:
                direction = 1 if value > extreme else -1
                extreme = value
            elif direction:
                extreme = value
        elif abs(value - extreme) > turn:
            count, direction, extreme = count + 1, -direction, value
    return float(count)


def _count_brakings(is_braking: Array, speed: Array) -> float:
    """Stretches of braking that take min_braking_mps off the speed."""
    runs = find_runs(is_braking, 1)
    return float(sum(speed[begin] - speed[end - 1] >= EXCITATION_CRITERIA.min_braking_mps for begin, end in runs))


class TooLittleDriving(InputError):
    """The logs cannot be diagnosed. `reasons` has the numbers of the message."""

    def __init__(self, message: str, reasons: tuple[Reason, ...], *, code: str, hint: str) -> None:
        super().__init__(message, code=code, key="LOG", hint=hint)
        self.reasons = reasons


def require_enough_driving(drives: Sequence[MeasuredDrive]) -> None:
    """Refuse logs that cannot be diagnosed.

    Raises:
        TooLittleDriving: the logs are too short, or the car hardly drives: its few moving rows would be all that is
            fitted.
    """
    ticks, dt_s = [drive.ticks for drive in drives], drives[0].dt_s
    blocks, block_s = cut_blocks(ticks, dt_s), block_length_s(ticks, dt_s)
    if blocks.count < BLOCK_CRITERIA.min_blocks:
        raise TooLittleDriving(
            f"the logs hold {blocks.count} blocks of {block_s:.3g} s; {BLOCK_CRITERIA.min_blocks} are needed for fit, "
            "selection and holdout",
            (Reason(Criterion.TOO_FEW_BLOCKS, value=blocks.count, limit=BLOCK_CRITERIA.min_blocks),),
            code="too_short",
            hint=f"record {DRIVING_CRITERIA.min_log_s:.0f} s or more; twice that shows more",
        )
    driven = sum(_count_driven_blocks(drive, blocks, i) for i, drive in enumerate(drives))
    if driven < BLOCK_CRITERIA.min_driven_blocks:
        idle = _find_idle_times(drives)
        raise TooLittleDriving(
            f"the car moves above walking pace in {driven} blocks of {block_s:.3g} s, as far as the logs show; "
            f"{BLOCK_CRITERIA.min_driven_blocks} are needed{_describe_idle_times(idle)}",
            (Reason(Criterion.TOO_FEW_DRIVEN_BLOCKS, value=driven, limit=BLOCK_CRITERIA.min_driven_blocks), *idle),
            code="standing",
            hint=f"drive for {DRIVING_CRITERIA.min_log_s:.0f} s or more, in gear, with by-wire enabled; leave out a "
            "report with long gaps: a log without it is read as well",
        )


def _find_idle_times(drives: Sequence[MeasuredDrive]) -> tuple[Reason, ...]:
    """What takes most of the time away from driving, the longest first."""
    seconds: dict[str, float] = {}
    for drive in drives:
        source = "ins.speed_mps" if drive.inputs.uses_ins_speed else "report.speed_mps"
        names = [source, *(f"report.{OUTPUT_FIELDS[channel]}" for channel in CHANNELS)]
        causes = {name: ~drive.signals[name].is_valid for name in names if name in drive.signals}
        causes[STANDING] = drive.inputs.speed_mps <= TARGET_CRITERIA.min_speed_mps * drive.size_scale
        causes[GEAR] = drive.inputs.gear < GEAR_DRIVE
        for key, rows in causes.items():
            seconds[key] = seconds.get(key, 0.0) + float(rows.sum()) * drive.dt_s
    total_s = sum(drive.ticks * drive.dt_s for drive in drives)
    min_s = DRIVING_CRITERIA.min_named_share * total_s
    longest = sorted((cause_s, _idle_text(key), key) for key, cause_s in seconds.items() if cause_s > min_s)[::-1]
    return tuple(Reason(Criterion.IDLE_TIME, value=cause_s, limit=total_s, key=key) for cause_s, _, key in longest)


def _idle_text(key: str) -> str:
    return {STANDING: "the car stands", GEAR: "it is in no forward gear"}.get(key, f"{key} is silent")


def _describe_idle_times(idle: Sequence[Reason]) -> str:
    """'' if there are none."""
    causes = ", ".join(f"{_idle_text(reason.key)} for {reason.value:.0f} s" for reason in idle)
    return f" (of {idle[0].limit:.0f} s {causes})" if causes else ""


def _count_driven_blocks(drive: MeasuredDrive, blocks: Blocks, index: int) -> int:
    """Blocks of a drive in which the car drives most of the time."""
    is_driving = drive.is_moving & (drive.inputs.speed_mps > TARGET_CRITERIA.min_speed_mps * drive.size_scale)
    is_of_drive = blocks.drives == index
    ends = zip(blocks.begins[is_of_drive], blocks.ends[is_of_drive], strict=True)
    return sum(bool(is_driving[begin:end].mean() > 0.5) for begin, end in ends)
