"""State bits as tables say what the nodes make of the frames, whatever the status."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.house import ROOT
from tunefree_hil.base.records import CanFrame
from tunefree_hil.batch.bits import bit_params, init_bits, receive_bits, set_bits, vehicle_state
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.recording.frame_writer import FrameWriter
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.nodes.measurement_decoder import MeasurementDecoder
from tunefree_hil.nodes.status_bits import StatusSignals
from tunefree_hil.plant.actuation.bywire import CAUSES, ByWireStatus, ChannelStatus

CODECS = {path.parent.name: Codec(load_vehicle(path.parent)) for path in (ROOT / "dbc").glob("*/vehicle.toml")}
BIT = st.sampled_from([0.0, 1.0])
CHANNEL = st.builds(ChannelStatus, BIT, BIT, BIT, BIT, BIT)
STATUS = st.builds(ByWireStatus, CHANNEL, CHANNEL, CHANNEL, BIT, BIT, st.sampled_from(sorted(CAUSES.values())))


def frames(writer: FrameWriter, signals: StatusSignals, status: ByWireStatus, names: set[str]) -> list[CanFrame]:
    said = signals.of(status)
    return [writer.write(m, {}, said[m.name], 0.0) for m in writer.codec.telemetry if m.name in names]


@pytest.mark.parametrize("vehicle", CODECS)
@given(data=st.data())
def test_the_tables_say_what_the_nodes_say(vehicle: str, data: st.DataObject) -> None:
    codec = CODECS[vehicle]
    speaking = [message for message in codec.telemetry if message.states]
    params = bit_params(speaking)
    state = init_bits(params)
    decoder, writer, signals = MeasurementDecoder(codec, 0.01), FrameWriter(codec), StatusSignals(codec)
    proving = {message.name for message in speaking if message.unproven_frames}
    decoder.receive(0, frames(writer, signals, ByWireStatus(), proving))
    for k in range(1, 5):
        status = data.draw(STATUS)
        heard = data.draw(st.sets(st.sampled_from([message.name for message in speaking])))
        decoder.receive(k, frames(writer, signals, status, heard))
        set_bits(params, state, status)
        for m, message in enumerate(speaking):
            if message.name in heard:
                receive_bits(state, m)
        assert vehicle_state(params, state) == decoder.state()


def test_nothing_heard_is_not_known() -> None:
    params = bit_params([message for message in next(iter(CODECS.values())).telemetry if message.states])
    assert not vehicle_state(params, init_bits(params)).known
