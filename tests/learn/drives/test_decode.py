"""Log statistics do not depend on how a log is cut into pieces; samples are placed on ticks."""

from __future__ import annotations

import math

import numpy as np

from tests.learn.made_logs import MKZ, car, rows_of
from tunefree_hil.bus.dbc.decode_columns import payloads_of
from tunefree_hil.episode.log_columns import Piece
from tunefree_hil.learn.drives.decode import LogStatistics, MessageDecoder, place_on_ticks

DT_S = 0.01


def piece(*time_s: float) -> Piece:
    stamps = np.array(time_s)
    nought = np.zeros(len(stamps), dtype=int)
    return Piece(stamps, nought, (("can0", 1),), payloads_of([b""] * len(stamps)), nought)


def statistics_of(*pieces: Piece, known: np.ndarray | None = None) -> LogStatistics:
    seen = LogStatistics()
    for one in pieces:
        seen.add_piece(one, np.ones(len(one.time_s), dtype=bool) if known is None else known, DT_S)
    return seen


def test_the_furthest_steps_of_the_clock_are_kept_across_pieces() -> None:
    stamps = (10.0, 10.01, 14.0, 13.2, 13.21, 13.3)
    whole, cut = statistics_of(piece(*stamps)), statistics_of(piece(*stamps[:3]), piece(*stamps[3:]))
    for seen in (whole, cut):
        assert math.isclose(seen.max_forward_step_s, 3.99) and seen.forward_step_at_s == 14.0
        assert math.isclose(seen.max_backward_step_s, 0.8) and seen.backward_step_at_s == 13.2
        assert (seen.frames, seen.vehicle_frames, seen.first_s, seen.earliest_s, seen.latest_s) == (
            6,
            6,
            10.0,
            10.0,
            14.0,
        )


def test_only_frames_of_the_vehicle_move_its_clock() -> None:
    known = np.array([True, False, True])
    seen = statistics_of(piece(0.0, 500.0, 0.01), known=known)
    assert (
        seen.max_forward_step_s == 0.01
        and seen.max_backward_step_s == 0.0
        and (seen.frames, seen.vehicle_frames) == (3, 2)
    )
    assert seen.latest_s == 500.0, "the log is as long as all of its frames"
    assert statistics_of(piece(0.0, 0.013)).max_off_tick > 0.29 and statistics_of(piece(0.0, 0.02)).max_off_tick < 1e-9


def grid_of(late_ticks: int, zero_s: float = 0.0) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], np.ndarray]:
    """Half a second of the MKZ, the frames of each message added in two pieces."""
    codec = car(MKZ).codec
    rows, decoders = rows_of(MKZ, 0.5), []
    for message in (*codec.telemetry, *codec.commands):
        mine = [row for row in rows if row.can_id == message.key]
        decoders.append(MessageDecoder(message))
        for half in (mine[: len(mine) // 2], mine[len(mine) // 2 :]):
            decoders[-1].add_frames(np.array([row.time_s for row in half]), payloads_of([row.data for row in half]))
    return place_on_ticks(decoders, DT_S, zero_s, late_ticks)


def test_reports_stand_as_many_ticks_later_as_they_are_late_and_commands_where_they_were_sent() -> None:
    punctual, _, _ = grid_of(0)
    later, fresh, enabled = grid_of(1)
    report, command = "report.speed_mps", "command.steer_rad"
    assert len(later[report]) == len(punctual[report]) + 1 == 51
    assert np.isnan(later[report][0]) and not fresh[report][0] and not enabled[0], "nothing was heard yet"
    np.testing.assert_array_equal(later[report][1:], punctual[report])
    np.testing.assert_array_equal(later[command][:50], punctual[command])
    assert enabled[1:].all()


def test_what_was_stamped_before_tick_0_is_left_out() -> None:
    all_, _, _ = grid_of(0)
    rest, fresh, _ = grid_of(0, zero_s=0.2)
    assert len(rest["report.speed_mps"]) == 30
    np.testing.assert_array_equal(rest["command.steer_rad"], all_["command.steer_rad"][20:])
    assert fresh["command.steer_rad"][0]
