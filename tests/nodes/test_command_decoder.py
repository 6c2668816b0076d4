"""What a by-wire unit makes of protected commands: a frame that is not believed is no frame."""

from __future__ import annotations

import pytest

from tests.bus.e2e_car import write_car
from tunefree_hil.base.records import CanFrame, Command
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.integrity import E2eStatus
from tunefree_hil.bus.recording.frame_writer import FrameWriter
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.nodes.command_decoder import CommandDecoder
from tunefree_hil.nodes.status_bits import set_bits
from tunefree_hil.plant.actuation.bywire import ByWireInput, ByWireParams, ReceivedCommand, bywire
from tunefree_hil.plant.vehicle import Driver

ENABLED = 'signal = "EN", bywire = "throttle" }]'
TOLD = """
e2e = [
    { message = "STATE", signal = "BAD", bywire = "brake" },
    { message = "STATE", signal = "WHY", active = 4, bywire = "brake", cause = "wrong_crc" },
]"""
BIT = ' SG_ EN : 39|1@0+ (1,0) [0|1] "" A\n'
BITS = ' SG_ BAD : 38|1@0+ (1,0) [0|1] "" A\n SG_ WHY : 47|3@0+ (1,0) [0|7] "" A\n'


@pytest.fixture(scope="module")
def codec(tmp_path_factory: pytest.TempPathFactory) -> Codec:
    return Codec(load_vehicle(write_car(tmp_path_factory.mktemp("car"), (ENABLED, ENABLED + TOLD), (BIT, BIT + BITS))))


class Road:
    """A sender of DRIVE and the ears that hear it."""

    def __init__(self, codec: Codec) -> None:
        self.codec, self.ears, self.writer = codec, CommandDecoder(codec), FrameWriter(codec)
        self.unit = bywire(ByWireParams())
        self.state = self.unit.init(self.unit.params, 0.01)

    def frame(self, throttle_frac: float = 0.3) -> CanFrame:
        command = {"command": Command(throttle_frac, 0.2, 0.1)}
        return self.writer.write(self.codec.by_name["DRIVE"], command, {"EN": 1.0}, 0.0)

    def status(self, heard: ReceivedCommand) -> object:
        seen = ByWireInput(heard, Driver(), 5.0, 0.0)
        self.state, out = self.unit.step(self.unit.params, self.state, seen, 0.01)
        return out.status


def broken(frame: CanFrame) -> CanFrame:
    return frame._replace(data=frame.data[:-1] + bytes((frame.data[-1] ^ 1,)))


def test_one_frame_feeds_three_channels_from_its_second_on(codec: Codec) -> None:
    road = Road(codec)
    first, second = road.ears.receive([road.frame()]), road.ears.receive([road.frame()])
    assert [one.fresh for one in first[:3]] == [0.0, 0.0, 0.0], "invalid until proven"
    assert {one.e2e for one in first[:3]} == {float(E2eStatus.INITIAL)}
    assert [one.fresh for one in second[:3]] == [1.0, 1.0, 1.0]
    values = [second.throttle.value, second.brake.value, second.steer.value]
    assert values == pytest.approx([0.3, 0.2, 0.1], abs=3e-4)
    assert {(one.e2e, one.enable, one.counter_ok) for one in second[:3]} == {(0.0, 1.0, 1.0)}


def test_a_broken_frame_is_not_fresh_and_says_why(codec: Codec) -> None:
    road = Road(codec)
    for _ in range(3):
        road.ears.receive([road.frame()])
    heard = road.ears.receive([broken(road.frame(0.9))])
    assert heard.throttle.fresh == heard.steer.fresh == 0.0
    assert heard.brake.e2e == E2eStatus.WRONG_CRC
    assert road.ears.receive([road.frame()]).throttle.fresh == 1.0


def test_a_copy_takes_nothing_away_from_its_original(codec: Codec) -> None:
    road = Road(codec)
    road.ears.receive([road.frame()])
    good = road.frame(0.4)
    heard = road.ears.receive([good, good])
    assert heard.throttle.fresh == 1.0 and heard.throttle.value == pytest.approx(0.4, abs=3e-4)
    assert heard.throttle.e2e == E2eStatus.REPEATED and heard.throttle.counter_ok == 1.0


def test_bad_commands_for_100_ms_are_a_time_out(codec: Codec) -> None:
    """Frames come all the time, none is believed: the channel's time-out acts as in silence."""
    road = Road(codec)
    for _ in range(5):
        status = road.status(road.ears.receive([road.frame()]))
    assert status.brake.enabled == 1.0 and status.brake.timeout == 0.0  # type: ignore[attr-defined]
    timeouts = [road.status(road.ears.receive([broken(road.frame())])).brake.timeout for _ in range(12)]  # type: ignore[attr-defined]
    assert timeouts == [0.0] * 9 + [1.0] * 3


def test_the_vehicle_says_in_which_bits_it_tells(codec: Codec) -> None:
    road, state = Road(codec), codec.by_name["STATE"]

    def bits(frames: list[CanFrame]) -> tuple[float, float]:
        found = set_bits(state, road.status(road.ears.receive(frames)))  # type: ignore[arg-type]
        return found["BAD"], found["WHY"]

    assert bits([road.frame()]) == (1.0, 0.0), "not proven yet"
    assert bits([road.frame()]) == (0.0, 0.0)
    assert bits([broken(road.frame())]) == (1.0, 4.0)
    assert bits([road.frame()]) == (0.0, 0.0), "some lost is good enough"
    assert [bits([]) for _ in range(3)][-1] == (1.0, 0.0), "no new data"
