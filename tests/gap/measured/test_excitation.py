"""What is refused before any search: logs that are too short, and a car that stands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from tests.learn.made_drives import made_drive
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.gap.measured.blocks import BLOCK_CRITERIA
from tunefree_hil.gap.measured.chain import MeasuredDrive, build_measured_drive
from tunefree_hil.gap.measured.excitation import DRIVING_CRITERIA, TooLittleDriving, require_enough_driving
from tunefree_hil.gap.selection.reasons import Criterion, Reason

VEHICLE = load_vehicle("mkz_bywire")


def opened(seconds: float) -> MeasuredDrive:
    return build_measured_drive(made_drive(seconds, seed=5), VEHICLE)


def refusal(drives: Sequence[MeasuredDrive]) -> TooLittleDriving:
    with pytest.raises(TooLittleDriving) as refused:
        require_enough_driving(drives)
    return refused.value


def test_a_log_that_is_too_short_is_refused_with_what_to_do() -> None:
    found = refusal([opened(30.0)])
    assert found.reasons == (Reason(Criterion.TOO_FEW_BLOCKS, value=5, limit=BLOCK_CRITERIA.min_blocks),)
    assert (
        found.code == "too_short"
        and "5 blocks of 5 s" in found.message
        and f"{DRIVING_CRITERIA.min_log_s:.0f} s" in found.hint
    )


def test_short_logs_are_enough_together() -> None:
    require_enough_driving([opened(45.0), opened(45.0)])


def test_a_car_that_stands_for_most_of_the_log_is_refused_with_what_to_do() -> None:
    one = opened(110.0)
    halted = one.is_moving.copy()
    halted[3000:] = False
    require_enough_driving([one])
    found = refusal([one._replace(is_moving=halted)])
    assert found.code == "standing" and "walking pace" in found.message and "in gear" in found.hint
    assert found.reasons[0].criterion is Criterion.TOO_FEW_DRIVEN_BLOCKS and found.key == "LOG"
    assert f"moves above walking pace in {found.reasons[0].value} blocks" in found.message
    assert (found.reasons[0].value or 0.0) < BLOCK_CRITERIA.min_driven_blocks == found.reasons[0].limit


@pytest.mark.parametrize("field", ["report.steer_rad", "report.brake_frac"])
def test_a_report_that_falls_silent_is_named_and_not_the_car(field: str) -> None:
    drive = made_drive(110.0, seed=5)
    late = np.arange(drive.n_rows) > 4500
    fields = {**drive.fields, field: np.where(late, np.nan, drive.fields[field])}
    one = build_measured_drive(
        drive._replace(fields=fields, fresh={**drive.fresh, field: drive.fresh[field] & ~late}), VEHICLE
    )
    found = refusal([one])
    assert f"{field} is silent for 6" in found.message and "stands for" not in found.message
    assert "long gaps" in found.hint
    (idle,) = [reason for reason in found.reasons if reason.criterion is Criterion.IDLE_TIME]
    assert idle.key == field and f"(of {idle.limit:.0f} s {field} is silent for {idle.value:.0f} s)" in found.message
