"""The simulated vehicle as a node: what it hears and answers, its watchdog, a scripted driver, when frames are due."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, cast

import pytest

from tests.bench.tiny import hash_of, write_bench
from tests.nodes.memory import FakeLink
from tests.nodes.stopped_clock import StoppedClock
from tunefree_hil.base.records import GEAR_DRIVE, GEAR_NONE, CanFrame, Command
from tunefree_hil.bench import VehicleFor, load
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.integrity import E2eStatus
from tunefree_hil.bus.link import separate_links
from tunefree_hil.nodes.command_decoder import CommandDecoder
from tunefree_hil.nodes.ecu import EcuPart
from tunefree_hil.nodes.exchange import Exchange
from tunefree_hil.nodes.timing import CycleTimes
from tunefree_hil.plant.actuation.bywire import CAUSES

CHANNELS = ("BRAKE_CMD", "THROTTLE_CMD", "STEERING_CMD")
WISH = Command(throttle_frac=0.2, brake_frac=0.15, steer_rad=0.0, gear=GEAR_DRIVE)


class Car:
    """An EcuPart that a test drives tick by tick; `receive` decodes its frames of a tick."""

    def __init__(self, folder: Path, more: str = "") -> None:
        self.folder = folder
        self.bench = load(write_bench(folder, more=more))
        self.codec: Codec = self.bench.codec
        self.said: list[str] = []
        self.part = EcuPart(self.codec, VehicleFor(self.bench, "mkz_nominal"), CycleTimes(), self.said.append)
        ids = (frozenset(m.key for m in self.codec.telemetry), frozenset(m.key for m in self.codec.commands))
        self.link = FakeLink()
        self.exchange = Exchange(separate_links(FakeLink(), self.link), ids, 0.01)
        self.k = 0
        self.load()

    def load(self) -> None:
        self.part.load(hash_of(self.folder), 3, {})
        self.k = 0

    def commands(
        self, leave_out: Iterable[str] = (), frozen: Iterable[str] = (), enable: float = 1.0
    ) -> list[CanFrame]:
        """The command frames of this tick; `frozen` counters do not count."""
        made = []
        for message in self.codec.commands:
            if self.k % message.period_ticks or message.name in leave_out:
                continue
            signals: dict[str, float] = {message.enable: 1.0} if message.enable else {}
            if message.counter:
                count = 0 if message.name in frozen else self.k % message.counter_modulus
                signals[message.counter] = float(count)
            data = self.codec.encode(message, {"command": WISH}, signals)
            made.append(CanFrame(message.can_id, data, message.extended, message.fd))
        return made

    def tick(self, frames: list[CanFrame] | None = None) -> dict[str, dict[str, float]]:
        """Publish and step once; the decoded frames by message."""
        sent = self.part._publish(self.k, self.k)
        heard = self.part._decode(self.commands() if frames is None else frames)
        self.part._step(self.k, heard)
        self.part._announce_faults(self.exchange, self.k)
        self.k += 1
        return {self.codec.by_id[one.id].name: self.codec.decode(self.codec.by_id[one.id], one.data) for one in sent}

    def run(self, ticks: int, **options: Any) -> dict[str, dict[str, float]]:
        """Ticks with such commands; the latest of each message."""
        heard: dict[str, dict[str, float]] = {}
        for _ in range(ticks):
            heard |= self.tick(self.commands(**options))
        return heard


@pytest.fixture
def car(tmp_path: Path) -> Car:
    return Car(tmp_path)


def test_what_the_ears_hear(car: Car) -> None:
    heard = CommandDecoder(car.codec).receive(car.commands())
    assert heard.throttle.value == pytest.approx(0.2, abs=2e-5)
    assert heard.steer.value == pytest.approx(0.0, abs=1e-3)
    assert [(one.enable, one.clear, one.ignore, one.fresh) for one in heard[:3]] == [(1.0, 0.0, 0.0, 1.0)] * 3
    assert heard.gear == GEAR_DRIVE and heard.gear_clear == 0.0
    assert CommandDecoder(car.codec).receive([]).brake.fresh == 0.0


def test_the_ears_notice_a_counter_that_does_not_count(car: Car) -> None:
    ears = CommandDecoder(car.codec)
    first = car.commands()
    assert ears.receive(first).brake.counter_ok == 1.0
    assert ears.receive(first).brake.counter_ok == 0.0
    car.k += 1
    assert ears.receive(car.commands()).brake.counter_ok == 1.0


def test_a_clear_frame_of_four_bytes_says_nothing_of_the_counter(car: Car) -> None:
    ears = CommandDecoder(car.codec)
    ears.receive(car.commands())
    message = car.codec.by_name["BRAKE_CMD"]
    clear = CanFrame(message.can_id, car.codec.encode(message, {}, {message.clear: 1.0}, 4))
    heard = ears.receive([clear]).brake
    assert (heard.clear, heard.counter_ok, heard.enable) == (1.0, 1.0, 0.0)


def test_a_command_that_is_too_short_is_no_command(car: Car) -> None:
    """GEAR_CMD may not be cut: a byte of it is noticed, and the gear stays unsaid."""
    ears, message = CommandDecoder(car.codec), car.codec.by_name["GEAR_CMD"]
    assert not message.allow_truncated and ears.receive([CanFrame(message.can_id, b"")]).gear == GEAR_NONE
    assert ears.reception.too_short == {"GEAR_CMD": 1}


def test_enabled_by_good_commands(car: Car) -> None:
    before = car.run(1)
    assert before["STEERING_REPORT"]["ENABLED"] == 0
    heard = car.run(20)
    assert [heard[f"{name}_REPORT"]["ENABLED"] for name in ("BRAKE", "THROTTLE", "STEERING")] == [1, 1, 1]
    assert heard["BRAKE_REPORT"]["WDCBRK"] == 0 and car.said == []
    assert heard["THROTTLE_REPORT"]["PC"] == pytest.approx(0.2, abs=1e-3)


@pytest.mark.parametrize(
    ("silent", "report", "cause"),
    [
        ("BRAKE_CMD", "BRAKE_REPORT", "brake_timeout"),
        ("THROTTLE_CMD", "THROTTLE_REPORT", "throttle_timeout"),
        ("STEERING_CMD", "STEERING_REPORT", "steer_timeout"),
    ],
)
def test_a_silent_command_times_out_and_the_watchdog_brakes(car: Car, silent: str, report: str, cause: str) -> None:
    """100 ms without frames: TMOUT in that channel's report, WDCBRK and the source code in the brake's, and braking."""
    car.run(30)
    heard = car.run(9, leave_out=[silent])
    assert heard[report]["TMOUT"] == 0
    assert [line.split(": ", 2)[2] for line in car.said] == [f"{silent}: no new data"], "named, no fault yet"
    heard = car.run(20, leave_out=[silent])
    others = {f"{name}_REPORT" for name in ("BRAKE", "THROTTLE", "STEERING")} - {report}
    assert heard[report]["TMOUT"] == 1 and all(heard[other]["TMOUT"] == 0 for other in others)
    assert heard["BRAKE_REPORT"]["WDCBRK"] == 1
    code = next(s.active for s in car.codec.by_name["BRAKE_REPORT"].states if s.cause == cause)
    assert heard["BRAKE_REPORT"]["WDCSRC"] == code
    assert heard["BRAKE_REPORT"]["PO"] > 0.25 and heard["THROTTLE_REPORT"]["PC"] == pytest.approx(0.15, abs=1e-3)
    faults = [message for message in car.link.words() if isinstance(message, bc.Fault)]
    assert [(one.role, one.index, one.code) for one in faults] == [(bc.Role.ECU, bc.NOT_SCRIPTED, CAUSES[cause])]
    assert len(car.said) == 2 and cause in car.said[1] and "brakes applied" in car.said[1]


def test_the_car_comes_to_a_stop_and_commands_do_not_bring_it_back(car: Car) -> None:
    car.run(30)
    rolling = car.run(1)["STEERING_REPORT"]["SPEED"]
    car.run(15, leave_out=["BRAKE_CMD"])
    heard = car.run(120)
    assert heard["STEERING_REPORT"]["SPEED"] < 0.6 * rolling
    assert heard["BRAKE_REPORT"]["WDCBRK"] == 1 and heard["BRAKE_REPORT"]["ENABLED"] == 0


@pytest.mark.parametrize(("frozen", "cause"), [("BRAKE_CMD", "brake_counter"), ("STEERING_CMD", "steer_counter")])
def test_a_counter_that_stands_still_trips_the_watchdog(car: Car, frozen: str, cause: str) -> None:
    car.run(30)
    heard = car.run(25, frozen=[frozen])
    report = frozen.replace("CMD", "REPORT")
    assert heard[report]["FLTWDC"] == 1 and heard["BRAKE_REPORT"]["WDCBRK"] == 1
    assert any(f"{frozen}: repeated" in line for line in car.said) and cause in car.said[-1]


def test_a_power_cycle_forgets_a_fault(car: Car) -> None:
    car.run(30)
    car.run(30, leave_out=["STEERING_CMD"])
    car.load()
    heard = car.run(30)
    assert heard["BRAKE_REPORT"]["WDCBRK"] == 0 and heard["STEERING_REPORT"]["ENABLED"] == 1


@pytest.mark.parametrize(
    ("channel", "value", "report"),
    [
        ("brake", 0.3, "BRAKE_REPORT"),
        ("throttle", 0.4, "THROTTLE_REPORT"),
        ("steer", 8.0, "STEERING_REPORT"),
        ("gear", 0.0, "GEAR_REPORT"),
    ],
)
def test_a_scripted_driver_takes_over(tmp_path: Path, channel: str, value: float, report: str) -> None:
    fault = (
        f'[[faults]]\nchannel = "{channel}"\nkind = "driver_override"\nfrom_tick = 40\nto_tick = 60\nvalue = {value}\n'
    )
    car = Car(tmp_path, fault)
    heard = car.run(40)
    assert heard[report]["OVERRIDE"] == 0
    heard = car.run(40)
    assert heard[report]["OVERRIDE"] == 1, "latched after the driver let go"
    assert all(heard[f"{name}_REPORT"]["ENABLED"] == 0 for name in ("BRAKE", "THROTTLE", "STEERING"))


def test_each_message_goes_out_on_its_own_tick(car: Car) -> None:
    """k + phase divisible by the period: docs/reference/files.md's seeded phases."""
    seen: dict[str, list[int]] = {message.name: [] for message in car.codec.telemetry}
    for k in range(40):
        for name in car.tick():
            seen[name].append(k)
    for message in car.codec.telemetry:
        phase = car.part.car.phases[message.name]
        assert seen[message.name] == [k for k in range(40) if (k + phase) % message.period_ticks == 0]
    assert {len(ticks) for ticks in seen.values()} == {40, 20, 8}


def test_the_same_commands_give_the_same_frames(car: Car) -> None:
    def drive() -> list[dict[str, dict[str, float]]]:
        car.load()
        return [car.tick() for _ in range(50)]

    assert drive() == drive()


def answers(car: Car, ticks: int, said: Any = None) -> tuple[list[list[CanFrame]], list[list[CanFrame]]]:
    """(vehicle batches, bench batches) of a controller that answers `ticks` ticks; `said` before its last DONE."""
    other = FakeLink()
    exchange = Exchange(separate_links(FakeLink(), other), (frozenset(), frozenset()), 0.01)
    vehicle = exchange.vehicle
    assert isinstance(vehicle, FakeLink)
    batches = []
    for car.k in range(ticks):
        before = [said] if said is not None and car.k == ticks - 1 else []
        other.sent.clear()
        exchange.announce(car.k, 1, car.commands(), *before)
        batches.append(other.frames())
    return vehicle.sent, batches


class FakeExchange:
    """Takes what the ECU announces."""

    def prepare(self, k: int, phase: int, frames: list[CanFrame], *before: Any) -> Any:
        return lambda: None


def run_lockstep(car: Car, ticks: int, said: Any = None, last: Any = None) -> FakeLink:
    vehicle, bench = FakeLink(), FakeLink()
    vehicle.later, bench.later = answers(car, ticks, said)
    if last is not None:
        bench.later.append([bc.encode(last)])
    car.load()
    car.part.lockstep(
        Exchange(separate_links(vehicle, bench), car.exchange.ids_of_phase, 0.01), lambda message: message == last
    )
    return bench


STOP = bc.Status(bc.Role.RUNNER, bc.State.STOP, 0, 0)


def test_lockstep_opens_each_tick_and_ends_with_the_course(car: Car) -> None:
    ticks = car.part.car.course.ticks
    bench = run_lockstep(car, ticks)
    opened = [message.k for message in bench.words() if isinstance(message, bc.Tick)]
    assert opened == list(range(ticks)) and ticks == 200
    assert bench.words()[-1] == bc.Status(bc.Role.ECU, bc.State.FINISHED, 0, ticks)


@pytest.mark.parametrize("ahead", [False, True])
def test_the_commands_of_every_tick_are_decoded(car: Car, ahead: bool) -> None:
    """Those of the last tick too, where a vehicle steps ahead of them."""
    assign = car.part.assign
    car.part.assign = lambda scenario, seed: assign(scenario, seed)._replace(ahead=ahead)
    run_lockstep(car, car.part.car.course.ticks)
    counts = car.part._decoder.reception.receivers["STEERING_CMD"].counts
    assert counts[E2eStatus.OK] + counts[E2eStatus.INITIAL] == car.part.car.course.ticks == sum(counts)
    failed = bc.Status(bc.Role.CONTROLLER, bc.State.FAILED, int(bc.ErrorCode.LEFT_LANE), 4)
    run_lockstep(car, 5, said=failed)
    assert sum(car.part._decoder.reception.receivers["STEERING_CMD"].counts) == 5


def test_a_vehicle_that_steps_ahead_announces_a_fault_after_the_controllers_done(car: Car) -> None:
    """Which of the two comes first must not depend on who computes faster: each fault is seen in a later wait."""
    assign, waited, announced = car.part.assign, [], []
    car.part.assign = lambda scenario, seed: assign(scenario, seed)._replace(ahead=True)
    car.load()

    class Controller(FakeExchange):
        def await_phase(self, k: int, phase: int, interrupt: Any) -> list[CanFrame]:
            waited.append(k)
            return []

        def send_messages(self, *messages: Any, k: int = 0) -> None:
            announced.extend((message.tick, list(waited)) for message in messages if isinstance(message, bc.Fault))

    car.part._cause = 99.0  # so that the first step changes it
    car.part.lockstep(cast(Exchange, Controller()), lambda message: False)
    assert announced == [(0, [0])]


def test_a_failure_the_controller_says_ends_the_episode_at_its_tick(car: Car) -> None:
    failed = bc.Status(bc.Role.CONTROLLER, bc.State.FAILED, int(bc.ErrorCode.LEFT_LANE), 4)
    bench = run_lockstep(car, 5, said=failed)
    assert bench.words()[-1] == bc.Status(bc.Role.ECU, bc.State.FAILED, bc.ErrorCode.LEFT_LANE, 5)


def test_a_request_to_stop_ends_the_episode(car: Car) -> None:
    bench = run_lockstep(car, 5, last=STOP)
    assert bench.words()[-1] == bc.Status(bc.Role.ECU, bc.State.FAILED, bc.ErrorCode.STOPPED, 5)


def test_in_real_time_what_follows_a_request_to_stop_is_kept(car: Car) -> None:
    bench = FakeLink()
    exchange = Exchange(separate_links(FakeLink(), bench), car.exchange.ids_of_phase, 0.01)
    end = bc.Status(bc.Role.RUNNER, bc.State.END, 0, 0)
    bench.say(STOP, end)
    car.part.realtime(exchange, StoppedClock(), 0.0, lambda message: message == STOP)
    assert bench.words()[-1] == bc.Status(bc.Role.ECU, bc.State.FAILED, bc.ErrorCode.STOPPED, 1)
    assert exchange.inbox == [end]
