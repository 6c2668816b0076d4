"""What is gathered of a log: its clock, in whatever pieces it comes, and its values on ticks."""

from __future__ import annotations

import math

import numpy as np

from tests.learn.made_logs import MKZ, car, rows_of
from tunefree_hil.bus.dbc.decode_columns import payloads_of
from tunefree_hil.episode.log_columns import Piece
from tunefree_hil.learn.drives.decode import Ear, Seen, place

DT_S = 0.01


def piece(*time_s: float) -> Piece:
    stamps = np.array(time_s)
    nought = np.zeros(len(stamps), dtype=int)
    return Piece(stamps, nought, (("can0", 1),), payloads_of([b""] * len(stamps)), nought)


def seen_of(*pieces: Piece, known: np.ndarray | None = None) -> Seen:
    seen = Seen()
    for one in pieces:
        seen.take(one, np.ones(len(one.time_s), dtype=bool) if known is None else known, DT_S)
    return seen


def test_the_furthest_steps_of_the_clock_are_kept_across_pieces() -> None:
    stamps = (10.0, 10.01, 14.0, 13.2, 13.21, 13.3)
    whole, cut = seen_of(piece(*stamps)), seen_of(piece(*stamps[:3]), piece(*stamps[3:]))
    for seen in (whole, cut):
        assert math.isclose(seen.ahead_s, 3.99) and seen.ahead_at_s == 14.0
        assert math.isclose(seen.back_s, 0.8) and seen.back_at_s == 13.2
        assert (seen.frames, seen.known, seen.first_s, seen.earliest_s, seen.latest_s) == (6, 6, 10.0, 10.0, 14.0)


def test_only_frames_of_the_vehicle_move_its_clock() -> None:
    known = np.array([True, False, True])
    seen = seen_of(piece(0.0, 500.0, 0.01), known=known)
    assert seen.ahead_s == 0.01 and seen.back_s == 0.0 and (seen.frames, seen.known) == (3, 2)
    assert seen.latest_s == 500.0, "the log is as long as all of its frames"
    assert seen_of(piece(0.0, 0.013)).off_grid > 0.29 and seen_of(piece(0.0, 0.02)).off_grid < 1e-9


def heard(late_ticks: int, zero_s: float = 0.0) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], np.ndarray]:
    """Half a second of the MKZ, each message heard in two pieces."""
    codec = car(MKZ).codec
    rows, ears = rows_of(MKZ, 0.5), []
    for message in (*codec.telemetry, *codec.commands):
        mine = [row for row in rows if row.can_id == message.key]
        ears.append(Ear(message))
        for some in (mine[: len(mine) // 2], mine[len(mine) // 2 :]):
            ears[-1].hear(np.array([row.time_s for row in some]), payloads_of([row.data for row in some]))
    return place(ears, DT_S, zero_s, late_ticks)


def test_reports_stand_as_many_ticks_later_as_they_are_late_and_commands_where_they_were_sent() -> None:
    now, _, _ = heard(0)
    later, fresh, enabled = heard(1)
    report, command = "report.speed_mps", "command.steer_rad"
    assert len(later[report]) == len(now[report]) + 1 == 51
    assert np.isnan(later[report][0]) and not fresh[report][0] and not enabled[0], "nothing was heard yet"
    np.testing.assert_array_equal(later[report][1:], now[report])
    np.testing.assert_array_equal(later[command][:50], now[command])
    assert enabled[1:].all()


def test_what_was_stamped_before_tick_0_is_left_out() -> None:
    all_, _, _ = heard(0)
    rest, fresh, _ = heard(0, zero_s=0.2)
    assert len(rest["report.speed_mps"]) == 30
    np.testing.assert_array_equal(rest["command.steer_rad"], all_["command.steer_rad"][20:])
    assert fresh["command.steer_rad"][0]
