"""What senders write, receivers believe: every message of every vehicle, drive after drive."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bus.e2e_car import write_car
from tunefree_hil.base.records import Command, Report
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.integrity import E2eStatus, Receiver
from tunefree_hil.bus.recording.frame_writer import FrameWriter
from tunefree_hil.config.load import load_vehicle

RECORDS = {"command": Command(0.3, 0.2, -0.5, 4.0), "report": Report()._replace(speed_mps=7.0)}


def codec_of(name: str, folder: Path) -> Codec:
    return Codec(load_vehicle(write_car(folder) if name == "little_fd" else name))


@pytest.mark.parametrize("vehicle", ["little_fd", "mkz_bywire"])
def test_written_frames_are_believed_one_after_the_other(vehicle: str, tmp_path: Path) -> None:
    codec = codec_of(vehicle, tmp_path)
    writer = FrameWriter(codec)
    for message in (*codec.commands, *codec.telemetry):
        receiver = Receiver(message)
        first = E2eStatus.INITIAL if message.counter else E2eStatus.OK
        for n in range(600):
            tick = n * message.period_ticks
            frame = writer.write(message, RECORDS, {}, tick * 0.01)
            assert receiver.receive(tick, frame.data) == (E2eStatus.OK if n else first)
            assert (frame.id, frame.fd, frame.time_s) == (message.can_id, message.fd, tick * 0.01)
            assert receiver.is_valid == (n >= message.unproven_frames)


@pytest.mark.parametrize("vehicle", ["little_fd", "mkz_bywire", "rav4_2017"])
def test_frames_are_those_of_the_codec(vehicle: str, tmp_path: Path) -> None:
    """With the same signals again, with other ones, and the counter counted on."""
    codec = codec_of(vehicle, tmp_path)
    writer = FrameWriter(codec)
    for message in (*codec.commands, *codec.telemetry):
        if message.e2e is not None:
            continue
        names = {message.enable, message.clear, *(state.signal for state in message.states)} - {""}
        ones, zeros = dict.fromkeys(names, 1.0), dict.fromkeys(names, 0.0)
        for n, signals in enumerate([ones, ones, zeros, ones, dict(zeros), zeros]):
            records = {"command": Command(0.1 * n, 0.2, -0.5, 4.0), "report": Report()._replace(speed_mps=float(n))}
            whole = {**signals, message.counter: float(n)} if message.counter else signals
            assert writer.write(message, records, signals, 0.0).data == codec.encode(message, records, whole)


def test_protection_changes_no_value(tmp_path: Path) -> None:
    codec = codec_of("little_fd", tmp_path)
    writer, message = FrameWriter(codec), codec.by_name["DRIVE"]
    for n in range(31):
        decoded = codec.decode(message, writer.write(message, RECORDS, {"EN": 1.0}, 0.0).data)
        assert (decoded["ALIVE"], decoded["ID_HIGH"], decoded["EN"]) == (n % 15, 1, 1)
        values = {name: value for _, name, value in codec.values(message, decoded)}
        assert values == pytest.approx({0: 0.3, 1: 0.2, 2: -0.5}, abs=2.5e-4)


def test_counters_begin_anew_with_an_episode(tmp_path: Path) -> None:
    codec = codec_of("little_fd", tmp_path)
    writer, message = FrameWriter(codec), codec.by_name["DRIVE"]
    first = writer.write(message, RECORDS, {}, 0.0)
    assert writer.write(message, RECORDS, {}, 0.0) != first
    writer.restart()
    assert writer.write(message, RECORDS, {}, 0.0) == first


def test_a_protected_message_is_never_cut_short(tmp_path: Path) -> None:
    """A clear frame of four bytes would have a wrong CRC; without protection its counter stands still."""
    little, mkz = codec_of("little_fd", tmp_path), codec_of("mkz_bywire", tmp_path)
    drive, brake = little.by_name["DRIVE"], mkz.by_name["BRAKE_CMD"]
    receiver, writer = Receiver(drive), FrameWriter(little)
    receiver.receive(0, writer.write(drive, {}, {}, 0.0).data)
    assert receiver.receive(1, writer.write_short(drive, {}, {"EN": 0.0}, 4, 0.0).data) is E2eStatus.OK
    plain = FrameWriter(mkz)
    assert len(plain.write_short(brake, {}, {"CLEAR": 1.0}, 4, 0.0).data) == 4
    assert mkz.decode(brake, plain.write(brake, {}, {}, 0.0).data)["COUNT"] == 0
