"""What a node notices of a stream of frames: statuses, silence, crowds; each said once, all counted."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bus.e2e_car import write_car
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.integrity import E2eStatus
from tunefree_hil.bus.recording.frame_writer import FrameWriter
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.nodes.reception import TOO_MANY, TOO_SHORT, Notice, Reception


@pytest.fixture
def little(tmp_path: Path) -> Codec:
    return Codec(load_vehicle(write_car(tmp_path)))


def run(codec: Codec, name: str, counts: dict[int, int], ticks: int, *, lockstep: bool = False) -> Reception:
    """`ticks` ticks of one message by its period; counts: other numbers of frames than 1, by tick."""
    message, writer, reception = codec.by_name[name], FrameWriter(codec), Reception(codec.telemetry)
    if lockstep:
        reception.expect_every_period()
    for k in range(ticks):
        due = k % message.period_ticks == 0
        for _ in range(counts.get(k, int(due))):
            reception.receive(message, writer.write(message, {}, {}, 0.0).data, k)
        reception.end_tick(k)
    return reception


def of(reception: Reception, name: str) -> list[tuple[int, str]]:
    return [(one.tick, one.problem) for one in reception.notices() if one.message == name]


@pytest.mark.parametrize("name", ["GYRO", "BRAKE_REPORT", "GEAR_REPORT"])
def test_good_frames_are_nothing_to_speak_of(codec: Codec, name: str) -> None:
    reception = run(codec, name, {}, 200)
    assert of(reception, name) == [] and name not in reception.troubles()


@pytest.mark.parametrize(("name", "period"), [("GYRO", 1), ("BRAKE_REPORT", 2), ("GEAR_REPORT", 5)])
def test_silence_is_noticed_once_and_counted_by_period(codec: Codec, name: str, period: int) -> None:
    """One tick of grace; then it is named, although nothing about the message is protected."""
    silent = {k: 0 for k in range(50, 50 + 10 * period)}
    reception = run(codec, name, silent, 100 + 20 * period)
    last = 50 - period
    assert of(reception, name) == [(last + period + 2, "no new data")]
    assert reception.troubles()[name][E2eStatus.NO_NEW_DATA] in (8, 9, 10)


@pytest.mark.parametrize(("name", "period"), [("GYRO", 1), ("BRAKE_REPORT", 2), ("GEAR_REPORT", 5)])
def test_in_lockstep_a_single_missing_frame_is_noticed_at_its_tick(codec: Codec, name: str, period: int) -> None:
    assert of(run(codec, name, {}, 100, lockstep=True), name) == []
    assert of(run(codec, name, {50: 0}, 100, lockstep=True), name) == [(50, "no new data")]
    assert of(run(codec, name, {50: 0}, 100), name) == ([] if period < 3 else [(52, "no new data")])


def test_in_lockstep_a_first_frame_that_never_comes_is_noticed_too(codec: Codec) -> None:
    silent = {k: 0 for k in range(0, 60, 5)}
    assert of(run(codec, "GEAR_REPORT", silent, 30, lockstep=True), "GEAR_REPORT") == [(5, "no new data")]


def test_a_frame_that_comes_one_tick_late_is_none_of_that(codec: Codec) -> None:
    """Real time: a frame misses its deadline and comes with the next one."""
    reception = run(codec, "GYRO", {50: 0, 51: 2, 70: 0, 71: 2, 90: 0, 91: 2}, 120)
    assert of(reception, "GYRO") == []


@pytest.mark.parametrize(("name", "period"), [("GYRO", 1), ("BRAKE_REPORT", 2), ("GEAR_REPORT", 5)])
def test_copies_are_noticed_within_250_ms_without_any_counter(codec: Codec, name: str, period: int) -> None:
    twice = {k: 2 for k in range(50, 150, period)}
    ((tick, what),) = of(run(codec, name, twice, 150), name)
    assert what == TOO_MANY and tick - 50 <= 3 * period


def test_what_a_gap_held_up_may_come_at_once(codec: Codec) -> None:
    """A stall of 40 ms, then four frames together: silence was said, a crowd is not."""
    held = {50: 0, 51: 0, 52: 0, 53: 4}
    assert [what for _, what in of(run(codec, "GYRO", held, 80), "GYRO")] == ["no new data"]


def test_a_protected_message_is_named_by_its_status(little: Codec) -> None:
    message, writer, reception = little.by_name["STATE"], FrameWriter(little), Reception(little.telemetry)
    frames = [writer.write(message, {}, {}, 0.0).data for _ in range(8)]
    heard = []
    for k, data in enumerate([frames[0], frames[1], frames[1], b"\xaa" * 16, frames[2], frames[3], frames[3]]):
        heard.append(reception.receive(message, data, 2 * k))
        reception.end_tick(2 * k)
    assert heard == [False, True, False, False, True, True, False], "the first one only says where the counter stands"
    words = [str(one) for one in reception.notices()]
    assert words == ["tick 4: STATE: repeated", "tick 6: STATE: wrong CRC"], "each kind once"
    assert reception.notices() == []
    assert reception.troubles() == {"STATE": [3, 0, 2, 0, 1, 0, 1, 0, 0]}
    assert reception.summary() == "STATE 2 repeated, 1 wrong CRC"
    assert reception.status("STATE") is E2eStatus.REPEATED


def test_a_frame_that_is_too_short_is_noticed_counted_and_not_believed(codec: Codec) -> None:
    message = codec.by_name["GYRO"]
    reception = Reception([message])
    whole = bytes(message.length)
    heard = []
    for k, data in enumerate([whole, b"", whole[:-1], whole, whole + b"more"]):
        heard.append(reception.receive(message, data, k))
        reception.end_tick(k)
    assert heard == [True, False, False, True, True]
    assert of(reception, "GYRO") == [(1, TOO_SHORT)]
    assert reception.troubles()["GYRO"] == [3, *[0] * 7, 2]
    assert reception.summary() == "GYRO 2 shorter than the DBC says"


def test_short_frames_alone_are_silence_too(codec: Codec) -> None:
    message, reception = codec.by_name["GYRO"], Reception(codec.telemetry)
    for k in range(10):
        reception.receive(message, b"" if k > 3 else bytes(message.length), k)
        reception.end_tick(k)
    assert [what for _, what in of(reception, "GYRO")] == [TOO_SHORT, E2eStatus.NO_NEW_DATA.words]


def test_a_notice_in_words() -> None:
    assert str(Notice(12, "STATE", "wrong CRC")) == "tick 12: STATE: wrong CRC"


def test_frames_in_time_let_extra_ones_be_forgotten(codec: Codec) -> None:
    """Two copies now and two later are no flood; two and two at once are one."""
    message, told = codec.by_name["GYRO"], []
    for ticks_between in (1, 8):
        reception = Reception(codec.telemetry)
        for tick in range(ticks_between + 1):
            for _ in range(3 if tick in (0, ticks_between) else 1):
                reception.receive(message, bytes(message.length), tick)
        told.append(reception.too_many)
    assert told == [{"GYRO": 2}, {}]
