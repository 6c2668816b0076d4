"""Decodes the frames of a log message by message and places their values on the vehicle's tick grid."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from tunefree_hil.bus.dbc.decode_columns import (
    Payloads,
    are_intact,
    are_long_enough,
    decode_fields,
    decode_signal,
    fit,
    is_there,
)
from tunefree_hil.bus.dbc.message_map import TELEMETRY, MessageMap, StateMap
from tunefree_hil.episode.log_columns import Piece

Array = np.ndarray
LATE_FRAME_S = 0.5  # after the frame before it; LateFrameCriteria judges how many are so late
DISABLING_CONDITIONS = ("override", "fault", "timeout", "watchdog")  # disable a channel unless they only warn


class TickGrid(NamedTuple):
    """Values and freshness by field, and whether by-wire control was enabled, each of shape (n_rows,)."""

    fields: dict[str, Array]
    fresh: dict[str, Array]
    enabled: Array


class FieldSamples(NamedTuple):
    """The received values of one field with their stamps, each of shape (n_samples,), in the log's order."""

    time_s: Array
    values: Array


class MessageDecoder:
    """Collects the frames of one message: its fields, whether it reports by-wire control enabled, and bad frames."""

    def __init__(self, message: MessageMap) -> None:
        self.message = message
        self.frames = self.short_frames = self.corrupt_frames = 0
        self.latest_s = -math.inf
        self.enabling_states = [state for state in message.states if state.condition == "enabled"]
        self.disabling_states = [
            state for state in message.states if state.condition in DISABLING_CONDITIONS and state.effect != "warn"
        ]
        self._times: list[Array] = []
        self._values: list[Array] = []
        self._is_present: list[Array] = []
        self._enabling: list[FieldSamples] = []
        self._disabling: list[FieldSamples] = []

    def add_frames(self, time_s: Array, payloads: Payloads) -> None:
        """Decode frames that follow those before them in the log; short and corrupt ones are only counted."""
        if not len(time_s):
            return
        self.frames += len(time_s)
        self.latest_s = max(self.latest_s, float(time_s.max()))
        payloads = fit(self.message, payloads)
        is_long_enough = are_long_enough(self.message, payloads)
        is_intact = are_intact(self.message, payloads)
        self.short_frames += int((~is_long_enough).sum())
        self.corrupt_frames += int((is_long_enough & ~is_intact).sum())
        rows = is_long_enough & is_intact
        time_s, payloads = time_s[rows], payloads.of(rows)
        fields = decode_fields(self.message, payloads)
        self._times.append(time_s)
        self._values.append(fields.values)
        self._is_present.append(fields.is_present)
        if self.enabling_states:
            self._enabling.append(_decode_enabled(self.message, self.enabling_states, time_s, payloads, True))
        if self.disabling_states:
            self._disabling.append(_decode_enabled(self.message, self.disabling_states, time_s, payloads, False))

    @property
    def times_s(self) -> Array:
        """Stamps of the good frames, shape (n_frames,)."""
        return np.concatenate(self._times) if self._times else np.zeros(0)

    def field_samples(self) -> dict[str, FieldSamples]:
        """Samples by field, 'report.speed_mps', without the frames that end before the field; empty without frames."""
        if not self._times:
            return {}
        time_s, values = np.concatenate(self._times), np.concatenate(self._values)
        is_present = np.concatenate(self._is_present)
        samples = {}
        for i, field in enumerate(self.message.fields):
            rows = is_present[:, i]
            if rows.any():
                samples[f"{field.group}.{field.name}"] = FieldSamples(time_s[rows], values[rows, i])
        return samples

    def enabled_samples(self, *, by_disabling: bool) -> FieldSamples | None:
        """1.0 where by-wire control is enabled, by the enabling (or the disabling) states; None without any frame."""
        pieces = self._disabling if by_disabling else self._enabling
        if not sum(len(piece.time_s) for piece in pieces):
            return None
        return FieldSamples(*(np.concatenate(arrays) for arrays in zip(*pieces, strict=True)))


def _decode_enabled(
    message: MessageMap, states: list[StateMap], time_s: Array, payloads: Payloads, active_value: bool
) -> FieldSamples:
    """1.0 where every state is active (inactive for active_value False), in frames with all of their signals."""
    is_present = np.ones(len(time_s), dtype=bool)
    is_enabled = np.ones(len(time_s), dtype=bool)
    for state in states:
        is_present &= is_there(message, state.signal, payloads)
        is_enabled &= (decode_signal(message, state.signal, payloads) == state.active) == active_value
    return FieldSamples(time_s[is_present], is_enabled[is_present].astype(np.float64))


class LogStatistics:
    """Frame counts and time stamps of a whole log; the stamps are infinite without any frame."""

    def __init__(self) -> None:
        self.frames = self.vehicle_frames = self.late_frames = 0
        self.unknown_ids: dict[int, int] = {}
        self.first_s = self.earliest_s = math.inf
        self.latest_s = -math.inf
        self.max_off_tick = 0.0
        self.max_backward_step_s = self.backward_step_at_s = self.max_forward_step_s = self.forward_step_at_s = 0.0
        self._last_s: float | None = None

    def count_unknown_id(self, can_id: int, frames: int) -> None:
        """Count frames of an id that the vehicle folder does not have."""
        if frames:
            self.unknown_ids[can_id] = self.unknown_ids.get(can_id, 0) + frames

    def add_piece(self, piece: Piece, is_vehicle_frame: Array, dt_s: float) -> None:
        """Count the frames of a piece and track its stamps. is_vehicle_frame: shape (n_frames,)."""
        time_s = piece.time_s
        self.first_s = min(self.first_s, float(time_s[0])) if not self.frames else self.first_s
        self.frames += len(time_s)
        self.vehicle_frames += int(is_vehicle_frame.sum())
        ticks = time_s / dt_s
        self.max_off_tick = max(self.max_off_tick, float(np.abs(ticks - np.rint(ticks)).max()))
        self.earliest_s = min(self.earliest_s, float(time_s.min()))
        self.latest_s = max(self.latest_s, float(time_s.max()))
        self._track_clock(time_s[is_vehicle_frame])

    def _track_clock(self, time_s: Array) -> None:
        """Keep the largest steps from one frame of the vehicle to the next."""
        if not len(time_s):
            return
        before_s = time_s[0] if self._last_s is None else self._last_s
        steps = np.diff(time_s, prepend=before_s)
        low, high = int(steps.argmin()), int(steps.argmax())
        if -steps[low] > self.max_backward_step_s:
            self.max_backward_step_s, self.backward_step_at_s = float(-steps[low]), float(time_s[low])
        if steps[high] > self.max_forward_step_s:
            self.max_forward_step_s, self.forward_step_at_s = float(steps[high]), float(time_s[high])
        self.late_frames += int((steps > LATE_FRAME_S).sum())
        self._last_s = float(time_s[-1])


def place_on_ticks(decoders: Iterable[MessageDecoder], dt_s: float, zero_s: float, late_ticks: int) -> TickGrid:
    """Place all samples on ticks, as episode/columns.py does: k = round((stamp - zero_s) / dt_s).

    There are as many rows as the last frame of the vehicle needs. Samples before tick 0 are left out, and so are fields
    without later ones.

    Args:
        late_ticks: by how many ticks a report is used after its stamp.
    """
    decoders = [decoder for decoder in decoders if decoder.frames]
    late = {decoder: late_ticks if decoder.message.kind == TELEMETRY else 0 for decoder in decoders}
    n_rows = max(round((decoder.latest_s - zero_s) / dt_s) + late[decoder] for decoder in decoders) + 1
    grid = TickGrid({}, {}, np.ones(max(0, n_rows), dtype=bool))
    for decoder in decoders:
        for name, samples in decoder.field_samples().items():
            rows, values = _newest_in_tick(samples, dt_s, zero_s, late[decoder])
            if len(rows):
                grid.fields[name], grid.fresh[name] = _hold(rows, values, n_rows)
    for decoder, samples in _enabled_sources(decoders):
        rows, values = _newest_in_tick(samples, dt_s, zero_s, late[decoder])
        is_enabled, _ = _hold(rows, values, n_rows)
        grid.enabled[:] &= is_enabled == 1.0  # False before the first report
    return grid


def _enabled_sources(decoders: list[MessageDecoder]) -> list[tuple[MessageDecoder, FieldSamples]]:
    """The messages with enabling states; if there are none, those with disabling states."""
    for by_disabling in (False, True):
        sources = [
            (decoder, samples)
            for decoder in decoders
            if (samples := decoder.enabled_samples(by_disabling=by_disabling)) is not None
        ]
        if sources:
            return sources
    return []


def _newest_in_tick(samples: FieldSamples, dt_s: float, zero_s: float, late_ticks: int) -> tuple[Array, Array]:
    """(row, value) of the last sample in each tick that has one."""
    rows = np.rint((samples.time_s - zero_s) / dt_s).astype(np.int64)
    is_inside = rows >= 0
    rows, values = rows[is_inside] + late_ticks, samples.values[is_inside]
    order = np.argsort(rows, kind="stable")
    rows, values = rows[order], values[order]
    is_newest = np.diff(rows, append=rows[-1] + 1 if len(rows) else 0) > 0
    return rows[is_newest], values[is_newest]


def _hold(rows: Array, values: Array, n_rows: int) -> tuple[Array, Array]:
    """(values, fresh): each value held until the next one, NaN before the first; fresh in these rows."""
    fresh = np.zeros(n_rows, dtype=bool)
    fresh[rows] = True
    number = np.cumsum(fresh) - 1
    values = np.where(number >= 0, values[np.maximum(number, 0)], np.nan) if len(rows) else np.full(n_rows, np.nan)
    return values, fresh
