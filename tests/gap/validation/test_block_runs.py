"""A proof shows what a hidden dead time costs, what its repair gives back, and a repair that makes things worse."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest

from tests.gap.made_answer import LATE_S, VEHICLE, late_drive, made_kept, made_model
from tests.learn.made_drives import NOISE, REST, made_drive
from tunefree_hil.base.records import GEAR_DRIVE, NAN, Command
from tunefree_hil.config.schema import EffectSpec
from tunefree_hil.gap.measured.blocks import HOLDOUT, cut_blocks
from tunefree_hil.gap.measured.chain import MeasuredDrive, build_measured_drive
from tunefree_hil.gap.measured.holdout_assignment import assign_holdout_blocks
from tunefree_hil.gap.validation.block_runs import DIVERGED_SQUARE, HEADING, POSITION, BlockErrors, Variant, run_blocks
from tunefree_hil.gap.validation.free_run import assemble_car, measured_pose, simulate_recording
from tunefree_hil.gap.validation.gap_closed import (
    MAX_FACTOR,
    MIN_CLOSED_SHARE,
    SignalGap,
    closed_share,
    error_floors,
    find_gross_misses,
    find_worse_signals,
    improved_by_recalibration,
    signal_gaps,
    signal_sizes,
    unpredictable_shares,
)
from tunefree_hil.gap.validation.repair import effect_specs, repair_model

STEER, YAW = "report.steer_rad", "ins.yaw_rate_radps"


@cache
def opened() -> MeasuredDrive:
    return build_measured_drive(late_drive(), VEHICLE)


@cache
def proof(delay_s: float = LATE_S) -> BlockErrors:
    model, kept = made_model(), made_kept()
    (effect,) = effect_specs(kept, "", "")
    effect = EffectSpec(name=effect.name, params={"delay_s": delay_s})
    made = repair_model(model, VEHICLE, kept.repaired_values, [effect])
    variants = {
        "before": Variant(model),
        "recalibrated": Variant(model),
        "after": Variant(made.model, made.day_effects),
    }
    return run_blocks(variants, VEHICLE, [opened()])


def test_the_true_repair_leaves_noise_on_every_block_of_the_proof() -> None:
    found = proof()
    floors = error_floors(found, made_model())
    gaps = signal_gaps(found, floors, {})
    assert found.n_blocks == int(np.sum(assign_holdout_blocks([opened()]).roles == HOLDOUT)) == 2
    assert gaps[STEER].before > 0.05 and gaps[STEER].after == pytest.approx(NOISE["steer_rad"], rel=0.3)
    assert gaps[YAW].before > 0.005 and gaps[YAW].after == pytest.approx(NOISE["yaw_rate_radps"], rel=0.1)
    assert gaps[POSITION].before > 4.0 * (gaps[POSITION].after or 1.0)
    assert all(one.floor <= min(one.before, one.after or 0.0) for one in gaps.values())
    closed = closed_share(found, floors)
    assert closed is not None and closed["value"] > 0.9 and closed["low"] <= closed["value"] <= closed["high"] <= 1.01
    assert find_worse_signals(found, floors) == {} and improved_by_recalibration(gaps) == {}


def test_traces_are_of_the_blocks_and_show_the_difference() -> None:
    found = proof()
    first = found.traces[0]
    assert len(found.traces) == 2 and first.time_s[0] == 0.0 and first.time_s[-1] == pytest.approx(8.0, abs=0.6)
    missed = {name: np.std(one[STEER] - first.measured[STEER]) for name, one in first.simulated.items()}
    assert missed["after"] < 0.05 * missed["before"]


def test_a_wrong_repair_is_worse_and_closes_nothing() -> None:
    found = proof(0.3)
    floors = error_floors(found, made_model())
    worse = find_worse_signals(found, floors)
    assert STEER in worse and worse[STEER] > 0.5 and "report.throttle_frac" not in worse
    closed = closed_share(found, floors)
    assert closed is not None and closed["value"] < 0.0


def test_a_model_that_lacks_nothing_leaves_nothing_to_explain() -> None:
    model = made_model()
    (effect,) = effect_specs(made_kept(), "", "")
    right = Variant(repair_model(model, VEHICLE, {}, [effect]).model)
    found = run_blocks({"before": right, "recalibrated": right, "after": right}, VEHICLE, [opened()])
    floors = error_floors(found, model)
    summed = (HEADING, POSITION)  # the INS is 0.2 ticks late: means of two of its values are quieter than these
    assert all(found.rms("after", one) == pytest.approx(floors[one], rel=0.2) for one in floors if one not in summed)
    assert closed_share(found, floors) == {"value": 0.0, "low": 0.0, "high": 0.0}


def test_of_drives_with_unlike_sensors_the_floor_is_as_loud_as_the_errors_are() -> None:
    one = opened()
    loud = 0.02 * np.random.default_rng(2).standard_normal(one.ticks)
    told = one.signals[STEER].received + loud
    noisy = one._replace(signals={**one.signals, STEER: one.signals[STEER]._replace(received=told, values=told)})
    model = made_model()
    (effect,) = effect_specs(made_kept(), "", "")
    right = Variant(repair_model(model, VEHICLE, {}, [effect]).model)
    found = run_blocks({"before": right, "after": right}, VEHICLE, [one, noisy])
    assert error_floors(found, model)[STEER] == pytest.approx(found.rms("after", STEER), rel=0.15)


def test_an_older_log_is_run_over_all_its_blocks() -> None:
    model = Variant(made_model())
    found = run_blocks({"before": model, "after": model}, VEHICLE, [opened()], role=None)
    assert found.n_blocks == cut_blocks([opened().ticks], 0.01).count - 1  # the first begins before commands count


def test_a_repair_of_half_the_value_does_not_close_it_all_whatever_foretells_the_rest() -> None:
    found, floors = proof(0.04), error_floors(proof(0.04), made_model())
    nothing, much = (unpredictable_shares({"steer": one, "yaw_rate": one}) for one in (0.0, 0.96))
    assert much["report.steer_rad"] == pytest.approx(0.2) and "report.throttle_frac" not in much, "not looked at"
    closed = closed_share(found, floors)
    assert closed is not None and closed["value"] < 0.8
    of_nothing, of_much = (closed_share(found, floors, left) for left in (nothing, much))
    assert of_nothing is not None and of_much is not None
    assert closed["value"] <= of_much["value"] < of_nothing["value"], "of what could be explained it is more"
    gap = signal_gaps(found, floors, much)[STEER]
    assert gap.after is not None and gap.unforetold == pytest.approx(0.2 * gap.after)
    assert gap.floor == signal_gaps(found, floors, nothing)[STEER].floor == pytest.approx(floors[STEER])


def test_a_block_in_which_chance_misses_more_is_no_gap_of_the_effect() -> None:
    """The steering is put right in both blocks; the speed, which the effect leaves alone, is off in one of them by as
    much as it is better than its floor in the other.
    """
    counts = np.full(2, 100.0)
    speed = 100.0 * np.array([1.4, 0.6]) ** 2
    steer = {"recalibrated": np.full(2, 900.0), "after": np.full(2, 50.0)}
    squares = {name: {"report.speed_mps": speed, STEER: some} for name, some in steer.items()}
    found = BlockErrors(squares, {name: counts for name in ("report.speed_mps", STEER)}, {}, ())
    closed = closed_share(found, {"report.speed_mps": 1.0, STEER: 1.0})
    assert closed is not None and closed["value"] == pytest.approx(1.0)
    worse = BlockErrors({**squares, "after": {"report.speed_mps": 4.0 * speed, STEER: steer["after"]}}, *found[1:])
    spoilt = closed_share(worse, {"report.speed_mps": 1.0, STEER: 1.0})
    assert spoilt is not None and spoilt["value"] < 0.8


@pytest.mark.parametrize(
    ("missed", "floor", "found"),
    [(0.5, 0.001, 0.5), (0.5, 0.4, None), (0.1, 0.001, None), (DIVERGED_SQUARE, 0.001, MAX_FACTOR)],
)
def test_gross_is_what_is_missed_of_the_signal_and_far_above_the_floor(
    missed: float, floor: float, found: float | None
) -> None:
    """Of a signal with a deviation of one; what has no deviation over the drives, or no gap, is not looked at."""
    gaps = {name: SignalGap(missed, None, None, floor, "rad") for name in (STEER, POSITION)}
    sizes = {STEER: 1.0, YAW: 1.0, "report.brake_frac": 0.0}
    assert find_gross_misses(gaps, sizes) == ({} if found is None else {STEER: found})
    assert find_gross_misses({STEER: SignalGap(missed, 0.01, None, floor, "rad")}, sizes) == {}, (
        "recalibration takes it away"
    )


def test_sizes_are_of_whole_drives_and_of_nothing_that_is_summed_up() -> None:
    sizes = signal_sizes([opened(), opened()])
    one = opened().signals[STEER]
    assert sizes[STEER] == pytest.approx(float(np.std(one.values[one.fresh & one.is_valid & opened().is_moving])))
    assert YAW in sizes and not [name for name in sizes if "speed" in name or "accel" in name or name == POSITION]
    without = opened()._replace(signals={name: one for name, one in opened().signals.items() if name != STEER})
    assert STEER not in signal_sizes([without]) and signal_sizes([without, opened()])[STEER] == pytest.approx(
        sizes[STEER]
    )
    assert YAW not in signal_sizes([opened()._replace(derived_ticks={YAW: 1})]), (
        "that wheels tell it is no sensor's word"
    )


def test_the_noise_of_reports_that_come_every_other_tick_is_known() -> None:
    found = proof()
    for signal, field in (("report.throttle_frac", "throttle_frac"), ("report.brake_frac", "brake_frac")):
        assert found.noise[signal] == pytest.approx(NOISE[field], rel=0.3), signal
    assert found.noise[STEER] == pytest.approx(NOISE["steer_rad"], rel=0.3)


def test_a_signal_of_steps_is_not_known_better_than_its_wire_rounds() -> None:
    drive, step = late_drive(), 0.02
    coarse = np.round(drive.fields[STEER] / step) * step
    driven = build_measured_drive(drive._replace(fields={**drive.fields, STEER: coarse}), VEHICLE)
    assert run_blocks({"before": Variant(made_model())}, VEHICLE, [driven]).noise[STEER] >= step / np.sqrt(12.0) * 0.999


def test_without_a_heading_places_are_compared_as_they_were_measured() -> None:
    drive, turned = late_drive(), 2.0
    fields = {name: values for name, values in drive.fields.items() if name != "ins.heading_rad"}
    x, y = fields["ins.x_m"], fields["ins.y_m"]
    fields["ins.x_m"] = 50.0 + np.cos(turned) * x - np.sin(turned) * y
    fields["ins.y_m"] = np.sin(turned) * x + np.cos(turned) * y
    placed = build_measured_drive(
        drive._replace(fields=fields, fresh={name: drive.fresh[name] for name in fields}), VEHICLE
    )
    heading = measured_pose(placed)[2]
    away = np.angle(np.exp(1j * (heading - drive.fields["ins.heading_rad"] - turned)))[placed.is_moving]
    assert np.sqrt(np.mean(away**2)) < 0.05
    (effect,) = effect_specs(made_kept(), "", "")
    right = Variant(repair_model(made_model(), VEHICLE, {}, [effect]).model)
    assert run_blocks({"after": right}, VEHICLE, [placed]).rms("after", POSITION) < 0.5 * proof().rms(
        "before", POSITION
    )


def test_where_a_person_drove_the_reported_outputs_act() -> None:
    drive = late_drive()
    kept = {name: values for name, values in drive.fields.items() if not name.startswith("command.")}
    kept = {name: values for name, values in kept.items() if "_command_" not in name}
    driven = build_measured_drive(
        drive._replace(fields=kept, fresh={name: drive.fresh[name] for name in kept}), VEHICLE
    )
    model = Variant(made_model())
    found = run_blocks({"before": model}, VEHICLE, [driven])
    assert found.n_blocks == 2 and found.rms("before", YAW) < 0.2 * proof().rms("before", YAW)


def test_a_block_in_which_somebody_takes_over_proves_nothing() -> None:
    enabled = np.ones(late_drive().n_rows, dtype=bool)
    begin = int(cut_blocks([late_drive().n_rows], 0.01).begins[3])
    fields = dict(late_drive().fields)
    for name in list(fields):  # without an echo, whether commands acted is what `enabled` says
        if "_command_" in name:
            del fields[name]
    enabled[begin + 100 : begin + 200] = False
    taken = build_measured_drive(late_drive()._replace(fields=fields, enabled=enabled), VEHICLE)
    assert run_blocks({"before": Variant(made_model())}, VEHICLE, [taken]).n_blocks == 1


def test_a_run_that_comes_to_no_number_is_worse_than_any_other(monkeypatch: pytest.MonkeyPatch) -> None:
    model = Variant(made_model())

    def wild(car: Any, drive: MeasuredDrive, held: np.ndarray, **how: bool) -> dict[str, np.ndarray]:
        said = {name: values.copy() for name, values in simulate_recording(car, drive, held).items()}
        said[STEER][5000:], said[YAW][5000:] = math.inf, 1e200
        said["report.speed_mps"][5000:] = math.nan
        return said

    good = run_blocks({"before": model}, VEHICLE, [opened()])
    monkeypatch.setattr("tunefree_hil.gap.validation.block_runs.simulate_recording", wild)
    bad = run_blocks({"before": model}, VEHICLE, [opened()])
    squares = {
        "before": good.squared_errors["before"],
        "recalibrated": good.squared_errors["before"],
        "after": bad.squared_errors["before"],
    }
    found = BlockErrors(squares, good.counts, good.noise, ())
    assert all(np.isfinite(one).all() for one in bad.squared_errors["before"].values())
    assert all(bad.squared_errors["before"][name].max() == DIVERGED_SQUARE for name in (STEER, YAW, "report.speed_mps"))
    floors = error_floors(found, made_model())
    worse, closed = find_worse_signals(found, floors), closed_share(found, floors)
    assert {STEER, YAW, "report.speed_mps"} <= set(worse) and max(worse.values()) <= MAX_FACTOR
    assert closed is not None and closed["value"] == closed["low"] == MIN_CLOSED_SHARE
    assert all(math.isfinite(one.after or 0.0) for one in signal_gaps(found, floors, {}).values())


def test_mathematics_that_refuse_a_number_end_a_run_and_not_the_proof() -> None:
    drive = opened()
    car = assemble_car(made_model(), VEHICLE, drive)
    step, calls = car.body.block.step, [0]

    def failing(*words: Any) -> Any:
        calls[0] += 1
        if calls[0] > 50:
            raise OverflowError("math range error")
        return step(*words)

    body = car.body._replace(block=car.body.block._replace(step=failing))
    said = simulate_recording(car._replace(body=body), drive, np.ones(drive.ticks, dtype=bool))
    assert np.isfinite(said[STEER][:51]).all() and np.isnan(said[STEER][51:]).all()


def test_a_car_that_stands_on_its_brakes_is_not_stopped_anew_in_each_tick() -> None:
    """Its wheels say a few centimetres a second; a late report would carry that braking into the block."""
    made = made_drive(12.0, script=lambda _: Command(REST, REST + 0.2, 0.0, GEAR_DRIVE, NAN, NAN), speed_mps=0.0)
    chance = np.random.default_rng(1)
    fields = {
        name: np.abs(0.02 * chance.standard_normal(made.n_rows)) if name.endswith(".speed_mps") else values
        for name, values in made.fields.items()
    }
    stands = build_measured_drive(made._replace(fields=fields), VEHICLE)
    late = EffectSpec(name="report_latency", params={"delay_s": 0.07})
    held = np.arange(made.n_rows) < 600
    said = simulate_recording(assemble_car(made_model(), VEHICLE, stands, [late]), stands, held)
    assert np.abs(said["report.accel_mps2"][600:700]).max() < 0.1 and np.abs(said["ins.speed_mps"][600:]).max() < 0.01
