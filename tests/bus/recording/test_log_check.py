"""Faults planted in a clean log are found, each by its own words, and nothing else is."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bus.e2e_car import write_car
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.e2e import protect
from tunefree_hil.bus.formats.rows import ERROR, RTR
from tunefree_hil.bus.recording.log_check import Frame, LogHealth, check_frames, declared_ranges
from tunefree_hil.config.load import load_vehicle

TICKS = 200
COUNTED = "THROTTLE_CMD"


@pytest.fixture(scope="module")
def codec() -> Codec:
    return Codec(load_vehicle("mkz_bywire"))


@pytest.fixture
def clean(codec: Codec) -> list[Frame]:
    """Every message of the folder on its period, counters counting."""
    frames: list[Frame] = []
    for k in range(TICKS):
        for message in (*codec.telemetry, *codec.commands):
            if k % message.period_ticks == 0:
                count = k // message.period_ticks
                signals = {message.counter: count % message.counter_modulus} if message.counter else {}
                data = codec.encode(message, {}, signals)
                frames.append((k * 0.01, "can0", message.key, data, 0))
    return frames


def of(codec: Codec, health: LogHealth, name: str):
    return next(one for one in health.messages if one.name == name)


def positions(frames: list[Frame], codec: Codec, name: str = COUNTED) -> list[int]:
    return [i for i, frame in enumerate(frames) if frame[2] == codec.by_name[name].key]


def test_a_clean_log_has_no_fault(codec: Codec, clean: list[Frame]) -> None:
    health = check_frames(clean, codec)
    assert health.problems == [] and health.foreign == {}
    throttle = of(codec, health, COUNTED)
    assert (throttle.frames, throttle.late, throttle.lost) == (TICKS, 0, 0)
    assert throttle.rate_hz == pytest.approx(100.0)
    assert throttle.longest_gap_s == pytest.approx(0.01)


@pytest.mark.parametrize("missing", [1, 2, 3])
def test_lost_frames_are_counted(codec: Codec, clean: list[Frame], missing: int) -> None:
    gone = positions(clean, codec)[50 : 50 + missing]
    health = check_frames([frame for i, frame in enumerate(clean) if i not in gone], codec)
    assert of(codec, health, COUNTED).lost == missing
    assert of(codec, health, COUNTED).late == 1
    assert health.problems == [f"{COUNTED}: {missing} frames are missing by its counter"]


def test_swapped_frames_are_not_lost_ones(codec: Codec, clean: list[Frame]) -> None:
    first, second = positions(clean, codec)[50:52]
    payload = clean[first][3], clean[second][3]
    clean[first] = (*clean[first][:3], payload[1], 0)
    clean[second] = (*clean[second][:3], payload[0], 0)
    health = check_frames(clean, codec)
    assert health.problems == [f"{COUNTED}: 1 frames came out of order"]
    assert of(codec, health, COUNTED).lost == 0


def test_a_sender_that_starts_anew_is_no_flood_of_swaps(codec: Codec, clean: list[Frame]) -> None:
    message = codec.by_name[COUNTED]
    for count, i in enumerate(positions(clean, codec)[130:]):
        data = codec.encode(message, {}, {message.counter: count % message.counter_modulus})
        clean[i] = (*clean[i][:3], data, 0)
    found = of(codec, check_frames(clean, codec), COUNTED)
    assert found.swapped <= 1 and found.lost < message.counter_modulus


def test_a_stuck_counter(codec: Codec, clean: list[Frame]) -> None:
    first, second = positions(clean, codec)[50:52]
    clean[second] = (*clean[second][:3], clean[first][3], 0)
    found = check_frames(clean, codec).problems
    assert f"{COUNTED}: 1 times the counter stood still" in found


def test_silence_is_named_with_its_time(codec: Codec, clean: list[Frame]) -> None:
    name = codec.telemetry[0].name
    gone = [i for i in positions(clean, codec, name) if 0.5 <= clean[i][0] < 1.5]
    found = check_frames([frame for i, frame in enumerate(clean) if i not in gone], codec).problems
    assert any(one.startswith(f"{name} is silent for 1.0") for one in found)


def test_a_report_that_was_never_heard(codec: Codec, clean: list[Frame]) -> None:
    name = codec.telemetry[-1].name
    gone = positions(clean, codec, name)
    assert check_frames([frame for i, frame in enumerate(clean) if i not in gone], codec).problems == [
        f"{name} was never received"
    ]


def test_commands_may_be_missing(codec: Codec, clean: list[Frame]) -> None:
    keys = {message.key for message in codec.commands}
    assert check_frames([frame for frame in clean if frame[2] not in keys], codec).problems == []


def test_short_foreign_error_and_remote_frames(codec: Codec, clean: list[Frame]) -> None:
    report = next(message for message in codec.telemetry if not message.allow_truncated)
    clean += [
        (2.00, "can0", report.key, b"\0", 0),
        (2.01, "can0", 0x7FF, b"\0", 0),
        (2.02, "can0", 0x7FF, b"\0", 0),
        (2.03, "can0", 0x004, b"", ERROR),
        (2.04, "can0", report.key, b"", RTR),
        (2.00, "can0", 0x7FE, b"", 0),
    ]
    health = check_frames(clean, codec)
    assert health.foreign == {0x7FE: 1, 0x7FF: 2}
    assert of(codec, health, report.name).short == 1
    assert [one.split(" ")[0] for one in health.problems] == [f"{report.name}:", "1", "1", "time"]


def test_channels_tell_equal_ids_apart(codec: Codec, clean: list[Frame]) -> None:
    other = Codec(load_vehicle("rav4_2017"))
    lka = next(message for message in other.commands if message.channel)
    frames: list[Frame] = [
        (k * 0.01, channel, lka.key, bytes(8), 0) for k in range(9) for channel in ("x", lka.channel)
    ]
    health = check_frames(frames, other, by_channel=True)
    assert of(other, health, lka.name).frames == 9
    assert health.foreign == {lka.key: 9}


def test_a_wrong_crc_is_found_and_its_counter_not_believed(tmp_path: Path) -> None:
    car = Codec(load_vehicle(write_car(tmp_path)))
    message = next(one for one in car.telemetry if one.e2e is not None)
    frames: list[Frame] = []
    for k in range(40):
        data = protect(message.e2e, car.encode(message, {}, {}), k % message.e2e.modulus)  # type: ignore[arg-type,union-attr]
        frames.append((k * message.period_ticks * 0.01, "can0", message.key, data, 1))
    assert not [one for one in check_frames(frames, car).problems if message.name in one]
    torn = bytearray(frames[20][3])
    torn[-1] ^= 0x40
    frames[20] = (*frames[20][:3], bytes(torn), 1)
    health = check_frames(frames, car)
    found = of(car, health, message.name)
    assert found.broken == 1 and found.lost == 1, "the frame that is not believed is missing"
    assert f"{message.name}: the CRC or data id of 1 frames does not fit" in health.problems


@pytest.mark.parametrize("padding", [1, 4, 48])
def test_what_pads_a_frame_to_a_length_of_can_fd_is_no_part_of_its_crc(tmp_path: Path, padding: int) -> None:
    """CAN FD knows 8, 12, 16, 20, 24, 32, 48 and 64 bytes: what is longer than the DBC says is filled up."""
    car = Codec(load_vehicle(write_car(tmp_path)))
    frames: list[Frame] = []
    protected = [one for one in (*car.telemetry, *car.commands) if one.e2e is not None]
    longest = max(one.period_ticks for one in protected)
    for message, k in ((one, k) for one in protected for k in range(40 * longest // one.period_ticks)):
        data = protect(message.e2e, car.encode(message, {}, {}), k % message.e2e.modulus)  # type: ignore[arg-type,union-attr]
        frames.append((k * message.period_ticks * 0.01, "can0", message.key, data + bytes(padding), 1))
    frames.sort(key=lambda frame: frame[0])
    health = check_frames(frames, car)
    assert [of(car, health, one.name).broken for one in protected] == [0 for _ in protected]
    assert health.problems == []


def test_without_a_profile_nothing_is_said_of_crcs(codec: Codec, clean: list[Frame]) -> None:
    assert all(one.broken is None for one in check_frames(clean, codec).messages)


def test_values_beyond_the_declared_range(codec: Codec, clean: list[Frame]) -> None:
    message, (name, (_, high)) = next(
        (one, next(iter(ranges.items()))) for one in codec.telemetry if (ranges := declared_ranges(one))
    )
    signal = message.signals[name]
    raw = signal.raw_high + 1
    i = positions(clean, codec, message.name)[5]
    data = codec.encode(message, {}, {name: raw})
    clean[i] = (*clean[i][:3], data, 0)
    health = check_frames(clean, codec)
    assert of(codec, health, message.name).beyond == 1
    assert [
        one for one in health.problems if one.startswith(f"{message.name}: {name} is outside") and "1 frames" in one
    ]
    assert raw * signal.factor + signal.offset > high


@pytest.mark.parametrize("late", [False, True])
def test_a_report_that_falls_silent_or_comes_late_is_a_fault_and_a_command_is_none(
    codec: Codec, clean: list[Frame], late: bool
) -> None:
    report = codec.telemetry[0]
    names = {report.key: report.name, codec.by_name[COUNTED].key: COUNTED}
    half = 0.5 * TICKS * 0.01
    kept = [frame for frame in clean if frame[2] not in names or (frame[0] >= half if late else frame[0] < half)]
    (problem,) = check_frames(kept, codec).problems
    assert problem.startswith((f"{report.name} is silent for 1.0", f"{report.name} is silent for 0.9"))
    assert problem.endswith("from 0.00 s on") == late


def test_a_counter_that_its_profile_never_shows_is_a_fault(tmp_path: Path) -> None:
    """Profile 1 counts to 14: receivers believe no 15."""
    car = Codec(load_vehicle(write_car(tmp_path)))
    message = next(one for one in (*car.telemetry, *car.commands) if one.e2e is not None and one.e2e.profile == "P01")
    frames: list[Frame] = []
    for k in range(45):
        data = protect(message.e2e, car.encode(message, {}, {}), k % 15 + 1)  # type: ignore[arg-type]
        frames.append((k * message.period_ticks * 0.01, "can0", message.key, data, 1))
    assert any("3 frames are counted beyond 14" in one for one in check_frames(frames, car).problems)
