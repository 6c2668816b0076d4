"""The controller's cycle: take-over, counters, clear frames, and every reason to stop commanding."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pytest

from tests.nodes.memory import FakeLink
from tests.nodes.stopped_clock import StoppedClock
from tests.nodes.test_measurement_decoder import ENABLED, enabled_frames, frame
from tunefree_hil.base.course import Tracking
from tunefree_hil.base.kernel import Block
from tunefree_hil.base.records import GEAR_DRIVE, CanFrame, Command
from tunefree_hil.bench import needed_messages
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.link import separate_links
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.control.cascade import ControllerInput, Decision
from tunefree_hil.nodes.controller import Assignment, ControllerPart
from tunefree_hil.nodes.exchange import Exchange
from tunefree_hil.nodes.handshake import limits_of
from tunefree_hil.nodes.timing import CycleTimes

WISH = Command(throttle_frac=0.25, brake_frac=0.15, steer_rad=0.5, gear=GEAR_DRIVE)
PERIODIC = ("THROTTLE_CMD", "BRAKE_CMD", "STEERING_CMD", "GEAR_CMD")


def stand_in(fail_at: int = -1, error: float = 0.0) -> Block:
    """A control law that always wishes WISH, and says `error` at one tick. Its state is the list of what it saw."""

    def step(
        params: Any, state: list[ControllerInput], x: ControllerInput, dt_s: float
    ) -> tuple[list[ControllerInput], Decision]:
        state.append(x)
        code = error if x.tick == fail_at else 0.0
        return state, Decision(WISH, Tracking(), 0.5, 0.0, 0.0, code)

    return Block(lambda params, dt_s: [], step, None)


class Seat:
    """A controller part with a stand-in law, and what it said."""

    def __init__(self, codec: Codec, block: Block | None = None, ticks: int = 100, dt_s: float = 0.01) -> None:
        self.codec = codec
        self.said: list[str] = []
        self.asked: list[tuple[bytes, Mapping[int, float]]] = []
        task = Assignment(block or stand_in(), ticks, dt_s)

        def assign(scenario: bytes, parameters: Mapping[int, float]) -> Assignment:
            self.asked.append((scenario, parameters))
            return task

        self.part = ControllerPart(codec, needed_messages(codec), assign, CycleTimes(), self.said.append)
        self.part.load(b"abcdef", 1, {0: 0.1})

    def all_frames(self, **more: Mapping[str, float]) -> list[CanFrame]:
        """Every message of a healthy vehicle; `more` sets state signals by message."""
        signals: dict[str, dict[str, float]] = {name: {"ENABLED": 1.0} for name in ENABLED}
        for name, own in more.items():
            signals.setdefault(name, {}).update(own)
        return [frame(self.codec, message.name, signals.get(message.name)) for message in self.codec.telemetry]

    def cycle(self, k: int, frames: Iterable[CanFrame] | None = None) -> tuple[dict[str, CanFrame], list[bc.Status]]:
        sent, words = self.part.cycle(k, list(self.all_frames() if frames is None else frames))
        return {self.codec.by_id[one.id].name: one for one in sent}, words

    def decoded(self, sent: Mapping[str, CanFrame], name: str) -> dict[str, float]:
        return self.codec.decode(self.codec.by_name[name], sent[name].data)


@pytest.fixture
def seat(codec: Codec) -> Seat:
    return Seat(codec)


def test_loading_asks_for_the_scenario_and_the_parameters(seat: Seat) -> None:
    assert seat.asked == [(b"abcdef", {0: 0.1})]


def test_engaged_it_sends_what_the_law_wishes(seat: Seat) -> None:
    sent, words = seat.cycle(0)
    assert set(PERIODIC) <= set(sent) and words == []
    throttle, steer = seat.decoded(sent, "THROTTLE_CMD"), seat.decoded(sent, "STEERING_CMD")
    assert throttle["EN"] == 1.0 and throttle["CLEAR"] == 0.0 and throttle["CMD_TYPE"] == 1.0
    assert throttle["PCMD"] == pytest.approx(0.25, abs=2e-5)
    assert steer["SCMD"] == pytest.approx(28.6479, abs=0.1) and steer["SVEL"] == 490.0
    assert seat.decoded(sent, "GEAR_CMD")["GCMD"] == GEAR_DRIVE
    assert {one.time_s for one in sent.values()} == {0.0}


def test_frames_are_stamped_with_their_tick_and_sent_by_their_period(seat: Seat) -> None:
    periods = {message.name: message.period_ticks for message in seat.codec.commands}
    for k in range(12):
        sent, _ = seat.cycle(k)
        assert set(sent) == {name for name, ticks in periods.items() if k % ticks == 0}
        assert {one.time_s for one in sent.values()} == {k * 0.01}
    assert max(periods.values()) > 1


def test_counters_roll(seat: Seat) -> None:
    modulus = seat.codec.by_name["BRAKE_CMD"].counter_modulus
    counts = [seat.decoded(seat.cycle(k)[0], "BRAKE_CMD")["COUNT"] for k in range(modulus + 2)]
    assert counts == [k % modulus for k in range(modulus + 2)]
    seat.part.load(b"abcdef", 1, {})
    assert seat.decoded(seat.cycle(0)[0], "BRAKE_CMD")["COUNT"] == 0


def test_it_asks_to_be_enabled_before_it_is(seat: Seat) -> None:
    """EN from the first frame on; the vehicle's bits of tick 0 are not set yet."""
    off = {name: {"ENABLED": 0.0} for name in ENABLED}
    for k in range(40):
        sent, words = seat.cycle(k, seat.all_frames(**off))
        assert words == [] and seat.decoded(sent, "BRAKE_CMD")["EN"] == 1.0
    sent, words = seat.cycle(40, seat.all_frames(**off))
    assert words == [bc.Status(bc.Role.CONTROLLER, bc.State.FAILED, bc.ErrorCode.NOT_ENABLED, 40)]
    assert "0.4 s" in seat.said[0]


@pytest.mark.parametrize(("dt_s", "last"), [(0.005, 80), (0.02, 20)])
def test_the_vehicle_has_0_4_s_to_enable_on_every_tick(codec: Codec, dt_s: float, last: int) -> None:
    seat, off = Seat(codec, dt_s=dt_s), {name: {"ENABLED": 0.0} for name in ENABLED}
    heard = [seat.cycle(k, seat.all_frames(**off))[1] for k in range(last + 1)]
    assert [k for k, words in enumerate(heard) if words] == [last]


def test_a_latched_override_is_cleared_by_frames_of_four_bytes(seat: Seat) -> None:
    """An 8-byte frame without a counter that counts would trip the watchdog (docs/reference/by_wire.md)."""
    latched = {name: {"ENABLED": 0.0} for name in ENABLED} | {"BRAKE_REPORT": {"ENABLED": 0.0, "OVERRIDE": 1.0}}
    clears = []
    for k in range(6):
        sent, words = seat.cycle(k, seat.all_frames(**latched))
        assert words == []
        if k in (0, 5):
            clears.append(sent)
            own = {message.name for message in seat.codec.commands if message.clear}
            assert {name for name, one in sent.items() if name in own} == own
            for name in own:
                assert len(sent[name].data) == min(4, seat.codec.by_name[name].length)
                assert seat.decoded(sent, name)["CLEAR"] == 1.0
                assert seat.decoded(sent, name).get("EN", 0.0) == 0.0
        else:
            assert all(seat.decoded(sent, name)["EN"] == 0.0 for name in PERIODIC[:3])
    assert len(clears) == 2
    sent, _ = seat.cycle(6, seat.all_frames(**{name: {"ENABLED": 0.0} for name in ENABLED}))
    assert seat.decoded(sent, "BRAKE_CMD")["EN"] == 1.0 and len(sent["BRAKE_CMD"].data) == 8


@pytest.mark.parametrize(
    ("message", "signal", "code", "word"),
    [
        ("BRAKE_REPORT", "OVERRIDE", bc.ErrorCode.OVERRIDE, "driver took over"),
        ("GEAR_REPORT", "OVERRIDE", bc.ErrorCode.OVERRIDE, "driver took over"),
        ("THROTTLE_REPORT", "FLT2", bc.ErrorCode.BYWIRE_FAULT, "fault"),
        ("STEERING_REPORT", "TMOUT", bc.ErrorCode.BYWIRE_FAULT, "fault"),
    ],
)
def test_lost_engagement_is_said_once_and_commands_stop(
    seat: Seat, message: str, signal: str, code: bc.ErrorCode, word: str
) -> None:
    seat.cycle(0)
    sent, words = seat.cycle(1, seat.all_frames(**{message: {signal: 1.0}}))
    assert words == [bc.Status(bc.Role.CONTROLLER, bc.State.FAILED, code, 1)]
    assert len(seat.said) == 1 and word in seat.said[0] and "tick 1" in seat.said[0]
    assert sent and all(seat.decoded(sent, name)["EN"] == 0.0 for name in sent)
    assert seat.decoded(sent, "THROTTLE_CMD")["PCMD"] == 0.0
    assert seat.cycle(2) == ({}, []), "a new request must be made by a person"
    assert len(seat.said) == 1


def test_a_channel_that_drops_by_itself_ends_it(seat: Seat) -> None:
    seat.cycle(0)
    why = limits_of(0.01).why_ticks
    heard = [seat.cycle(k, seat.all_frames(THROTTLE_REPORT={"ENABLED": 0.0}))[1] for k in range(1, why + 1)]
    assert [len(words) for words in heard] == [0] * (why - 1) + [1]
    assert heard[-1][0].error_code == bc.ErrorCode.NOT_ENABLED


@pytest.mark.parametrize(
    ("silent", "code"),
    [
        ("INS_POS_LOCAL", bc.ErrorCode.INS_MISSING),
        ("INS_ANGULAR_VELOCITY", bc.ErrorCode.INS_MISSING),
        ("STEERING_REPORT", bc.ErrorCode.CHASSIS_MISSING),
    ],
)
def test_a_message_that_is_missing_for_0_2_s_is_named(seat: Seat, silent: str, code: bc.ErrorCode) -> None:
    seat.cycle(0)
    lost_id = seat.codec.by_name[silent].can_id
    rest = [one for one in seat.all_frames() if one.id != lost_id]
    for k in range(1, 21):
        sent, words = seat.cycle(k, rest)
        assert words == [] and sent, f"tick {k}: 0.2 s are not over"
    sent, words = seat.cycle(21, rest)
    assert sent == {} and words == [bc.Status(bc.Role.CONTROLLER, bc.State.FAILED, code, 21)]
    assert "no new data" in seat.said[0] and silent in seat.said[0], "named at once"
    assert silent in seat.said[-1] and "0.2 s" in seat.said[-1]
    assert seat.cycle(22) == ({}, [])


def test_one_frame_that_is_too_short_does_not_end_the_drive(seat: Seat) -> None:
    seat.cycle(0)
    frames = [one._replace(data=one.data[:1]) for one in seat.all_frames()]
    sent, words = seat.cycle(1, frames)
    assert sent and words == []
    assert sorted(seat.said) == sorted(
        f"controller: tick 1: {message.name}: shorter than the DBC says" for message in seat.codec.telemetry
    )
    assert seat.cycle(2)[1] == [] and len(seat.said) == len(seat.codec.telemetry)


def test_reports_that_nobody_needs_may_be_missing(seat: Seat) -> None:
    seat.cycle(0)
    needed = {name for names in needed_messages(seat.codec).values() for name in names} | set(ENABLED)
    rest = [one for one in seat.all_frames() if seat.codec.by_id[one.id].name in needed]
    assert len(rest) < len(seat.all_frames())
    assert all(seat.cycle(k, rest)[1] == [] for k in range(1, 60))


@pytest.mark.parametrize("code", [bc.ErrorCode.DIVERGED, bc.ErrorCode.LEFT_LANE])
def test_its_own_supervision_ends_the_drive(codec: Codec, code: bc.ErrorCode) -> None:
    seat = Seat(codec, stand_in(fail_at=3, error=float(code)))
    assert [seat.cycle(k)[1] for k in range(3)] == [[], [], []]
    sent, words = seat.cycle(3)
    assert words == [bc.Status(bc.Role.CONTROLLER, bc.State.FAILED, code, 3)] and sent
    assert seat.cycle(4) == ({}, [])


def test_the_law_sees_the_tick_and_the_latest_values(codec: Codec) -> None:
    seen: list[ControllerInput] = []
    block = stand_in()._replace(init=lambda params, dt_s: seen)
    seat = Seat(codec, block)
    seat.cycle(0)
    seat.cycle(1, enabled_frames(codec))
    assert [sight.tick for sight in seen] == [0, 1]
    assert seen[1].measurement.report == seen[0].measurement.report


def test_lockstep_answers_each_tick_and_ends_when_told(codec: Codec) -> None:
    seat = Seat(codec)
    vehicle, bench = FakeLink(), FakeLink()
    ids = (frozenset(m.key for m in codec.telemetry), frozenset(m.key for m in codec.commands))
    exchange = Exchange(separate_links(vehicle, bench), ids, 0.01)
    other = FakeLink()
    ecu = Exchange(separate_links(other, other), ids, 0.01)
    for k in range(3):
        ecu.announce(k, 0, seat.all_frames(), bc.Tick(k))
    for one in other.frames():
        (vehicle if one.id in codec.by_id else bench).arrive(one)
    stop = bc.Status(bc.Role.RUNNER, bc.State.STOP, 0, 0)
    size = len(codec.telemetry)  # frames of three ticks wait at once: hand them over tick by tick, as lockstep does
    vehicle.later = [vehicle.waiting[i : i + size] for i in (0, size, 2 * size)]
    vehicle.waiting = vehicle.later.pop(0)
    bench.say(stop)
    seat.part.lockstep(exchange, lambda message: message == stop)
    done = [message for message in bench.words() if isinstance(message, bc.Done)]
    assert [(one.k, one.phase) for one in done] == [(0, 1), (1, 1), (2, 1)]
    assert sum(one.n_tx for one in done) == len(vehicle.frames())
    assert len(seat.part.times.control_s) == 3


def test_in_real_time_the_next_episode_may_follow_the_end_in_one_batch(codec: Codec) -> None:
    """A runner that only joined does not wait between drives: what follows ECU FINISHED is the next episode's."""
    seat = Seat(codec)
    bench = FakeLink()
    exchange = Exchange(separate_links(FakeLink(), bench), (frozenset(), frozenset()), 0.01)
    finished = bc.Status(bc.Role.ECU, bc.State.FINISHED, 0, 0)
    next_one = [bc.Episode(b"ghijkl", 2), bc.Param(0, 1, 0.5)]
    bench.say(bc.Tick(0), finished, *next_one)
    seat.part.realtime(exchange, StoppedClock(), 0.0, lambda message: message == finished)
    assert len(seat.part.times.control_s) == 1, "it went on after the end"
    assert [exchange.next_message(0.0) for _ in range(3)] == [*next_one, None]


def test_a_command_that_is_not_enabled_asks_for_nothing_where_raw_0_would(repo: Path, tmp_path: Path) -> None:
    """An angle coded as (0.1,-470) says -470 degrees by raw 0."""
    car = shutil.copytree(repo / "dbc" / "mkz_bywire", tmp_path / "car")
    dbc, signed = car / "vehicle.dbc", " SG_ SCMD : 0|16@1- (0.1,0) [-470|470]"
    text = dbc.read_text()
    assert signed in text
    dbc.write_text(text.replace(signed, " SG_ SCMD : 0|16@1+ (0.1,-470) [-470|470]"))
    seat = Seat(Codec(load_vehicle(car)))
    latched = {name: {"ENABLED": 0.0} for name in ENABLED} | {"BRAKE_REPORT": {"ENABLED": 0.0, "OVERRIDE": 1.0}}
    cleared, _ = seat.cycle(0, seat.all_frames(**latched))
    waits, _ = seat.cycle(1, seat.all_frames(**latched))
    for sent in (cleared, waits):
        assert seat.decoded(sent, "STEERING_CMD")["SCMD"] == pytest.approx(0.0)
        assert seat.decoded(sent, "STEERING_CMD").get("EN", 0.0) == 0.0
