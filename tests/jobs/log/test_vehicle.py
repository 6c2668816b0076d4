"""The vehicle folder of an imported drive: how often its messages come, what it lacks, what is said to be assumed."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from tunefree_hil.base.records import GROUPS, WHEEL_FIELDS
from tunefree_hil.config.import_schema import ClockSpec, ColumnSpec, ImportSpec
from tunefree_hil.config.vehicle_schema import LimitsSpec
from tunefree_hil.episode.csv_drive import Column, CsvDrive
from tunefree_hil.jobs.log.vehicle import vehicle_table

SPEC = ImportSpec(
    schema="tunefree.import/1", name="made", source="a test", clock=ClockSpec(column="t"), columns=[], path="m.toml"
)
UNIT: Any = "1"  # of no matter: values are SI by now


def column(field: str, values: list[float], every: int = 1, **said: Any) -> Column:
    """Of which each `every`-th row was sent."""
    sent = np.arange(len(values)) % every == 0
    return Column(ColumnSpec(column="c", field=field, unit=UNIT, **said), np.array(values), sent)


def drive(step_s: float, *columns: Column, enabled: list[float] | None = None) -> CsvDrive:
    rows = len(columns[0].values)
    time_s = np.arange(rows) * step_s
    by_name = {one.spec.field: one for one in columns}
    return CsvDrive(time_s, by_name, [], step_s, None if enabled is None else np.array(enabled))


SPEED = column("report.speed_mps", [3.0, -12.31, 4.0, 5.0])


@pytest.mark.parametrize(
    ("step_s", "every", "period_ms", "tick_ms"),
    [(0.02, 1, 20, 10), (0.02, 2, 40, 10), (0.0214, 1, 20, 10), (0.005, 1, 5, 5), (0.0081, 1, 10, 10), (1e-4, 1, 1, 1)],
)
def test_a_message_comes_as_often_as_it_was_sent(step_s: float, every: int, period_ms: int, tick_ms: int) -> None:
    table = vehicle_table(SPEC, drive(step_s, column("report.speed_mps", [1.0] * 12, every)))
    assert (table["report"]["speed_mps"]["period_ms"], table["tick_ms"]) == (period_ms, tick_ms)


def test_the_tick_divides_all_periods_and_a_period_that_is_said_counts() -> None:
    mixed = drive(0.005, SPEED, column("ins.x_m", [0.0] * 4, period_ms=8), enabled=[1.0, np.nan, 0.0, np.nan])
    table = vehicle_table(SPEC, mixed)
    assert table["report"]["speed_mps"]["period_ms"] == 5 and table["ins"]["x_m"]["period_ms"] == 10
    assert table["extra"] == {"BYWIRE_STATE": {"kind": "telemetry", "period_ms": 10}}, "where a cell says it"
    assert table["state"]["enabled"] == [{"message": "BYWIRE_STATE", "signal": "ENABLED"}]
    assert table["tick_ms"] == 5
    assert not {"extra", "state"} & vehicle_table(SPEC, drive(0.02, SPEED)).keys()


def test_what_the_drive_has_is_told_and_all_else_is_absent() -> None:
    table = vehicle_table(SPEC, drive(0.02, SPEED, column("command.gear", [1.0] * 4, assumed="nobody wrote it down")))
    entry = table["report"]["speed_mps"]
    assert (entry["message"], entry["signal"]) == ("REPORT_SPEED", "SPEED") and "assumed" not in entry
    assert table["command"]["gear"]["assumed"] == "nobody wrote it down"
    there = {f"{group}.{name}" for group in GROUPS for name in table.get(group, {})}
    assert there == {"report.speed_mps", "command.gear"} and there.isdisjoint(table["absent"])
    assert {"ins.x_m", "report.steer_rad", "report.wheel_speed_radps"} <= set(table["absent"])
    assert "data_bitrate" not in table


def test_four_wheels_are_four_signals_of_a_can_fd_message() -> None:
    wheels = [column(f"report.{name}", [1.0] * 4) for name in WHEEL_FIELDS]
    table = vehicle_table(SPEC, drive(0.02, SPEED, *wheels))
    entry = table["report"].pop("wheel_speed_radps")
    assert entry["message"] == "REPORT_WHEEL_SPEED" and len(set(entry["signal"])) == 4
    assert list(table["report"]) == ["speed_mps"], "no wheel has an entry of its own"
    assert table["data_bitrate"] == 2_000_000 and "report.wheel_speed_radps" not in table["absent"]


def test_limits_nobody_gave_are_what_was_driven_and_said_to_be_assumed() -> None:
    unsent = column("ins.speed_mps", [1.0, 99.0, 1.0, 99.0], every=2)
    limits = vehicle_table(SPEC, drive(0.02, SPEED, unsent, column("report.steer_rad", [0.0] * 4)))["limits"]
    assert limits["speed_mps"] == pytest.approx(12.4), "the greatest that was sent, backwards too, rounded up"
    assert limits["steer_rad"] == 8.0, "of one that never moved a round figure"
    assert limits["assumed"] == [name for name in limits if name != "assumed"]


def test_limits_that_were_given_are_taken_as_they_are() -> None:
    given = LimitsSpec(steer_rad=4.0, steer_rate_radps=5.0, throttle_frac=0.8, brake_frac=0.9, speed_mps=30.0)
    table = vehicle_table(msgspec.structs.replace(SPEC, limits=given), drive(0.02, SPEED))
    assert table["limits"]["speed_mps"] == 30.0 and table["limits"]["steer_rad"] == 4.0
    assert not table["limits"].get("assumed")
