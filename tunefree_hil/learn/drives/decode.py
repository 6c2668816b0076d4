"""What a log says, gathered message by message, and laid on the vehicle's tick grid (learn/drives/read.py)."""

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
SLOW_S = 0.5  # from one frame of the vehicle to the next; more is a silence, and where most are, no clock in seconds
DISABLING = ("override", "fault", "timeout", "watchdog")  # conditions that take a channel, where their effect does


class Grid(NamedTuple):
    """Fields and freshness by row, and whether the by-wire channels obeyed (learn/drives/drive.py)."""

    fields: dict[str, Array]
    fresh: dict[str, Array]
    enabled: Array


class Column(NamedTuple):
    """One field of one message as heard: stamps [m] in the log's order, values [m]."""

    time_s: Array
    values: Array


class Ear:
    """All that was heard of one message: its fields, whether it says that by-wire obeys, and what was not believed."""

    def __init__(self, message: MessageMap) -> None:
        self.message = message
        self.frames = self.short = self.broken = 0
        self.latest_s = -math.inf
        self.enables = [state for state in message.states if state.condition == "enabled"]
        self.disables = [one for one in message.states if one.condition in DISABLING and one.effect != "warn"]
        self._times: list[Array] = []
        self._values: list[Array] = []
        self._there: list[Array] = []
        self._obeys: dict[str, list[Column]] = {"enables": [], "disables": []}

    def hear(self, time_s: Array, payloads: Payloads) -> None:
        """Take in frames in the log's order."""
        if not len(time_s):
            return
        self.frames += len(time_s)
        self.latest_s = max(self.latest_s, float(time_s.max()))
        payloads = fit(self.message, payloads)
        enough = are_long_enough(self.message, payloads)
        intact = are_intact(self.message, payloads)
        self.short += int((~enough).sum())
        self.broken += int((enough & ~intact).sum())
        rows = enough & intact
        time_s, payloads = time_s[rows], payloads.of(rows)
        fields = decode_fields(self.message, payloads)
        self._times.append(time_s)
        self._values.append(fields.values)
        self._there.append(fields.there)
        for which, states in (("enables", self.enables), ("disables", self.disables)):
            if states:
                self._obeys[which].append(_obeyed(self.message, states, time_s, payloads, which == "enables"))

    @property
    def times_s(self) -> Array:
        """Stamps of the frames that are believed."""
        return np.concatenate(self._times) if self._times else np.zeros(0)

    def columns(self) -> dict[str, Column]:
        """By field, 'report.speed_mps'; frames that end before a field are left out of it. Empty where none came."""
        if not self._times:
            return {}
        time_s, values, there = (np.concatenate(some) for some in (self._times, self._values, self._there))
        found = {}
        for place_in_frame, one in enumerate(self.message.fields):
            rows = there[:, place_in_frame]
            if rows.any():
                found[f"{one.group}.{one.name}"] = Column(time_s[rows], values[rows, place_in_frame])
        return found

    def obeys(self, which: str) -> Column | None:
        """1 where the message says by its 'enables' (or 'disables') that by-wire obeys; None where it never can say."""
        some = self._obeys[which]
        if not sum(len(one.time_s) for one in some):
            return None
        return Column(*(np.concatenate(parts) for parts in zip(*some, strict=True)))


def _obeyed(message: MessageMap, states: list[StateMap], time_s: Array, payloads: Payloads, enabled: bool) -> Column:
    """From frames that hold all the states' signals: 1.0 where all of `enables`, or none of `disables`, are active."""
    there = np.ones(len(time_s), dtype=bool)
    obeys = np.ones(len(time_s), dtype=bool)
    for state in states:
        there &= is_there(message, state.signal, payloads)
        obeys &= (decode_signal(message, state.signal, payloads) == state.active) == enabled
    return Column(time_s[there], obeys[there].astype(np.float64))


class Seen:
    """The log as a whole: counts, and what its stamps are like. Infinite where there was no frame."""

    def __init__(self) -> None:
        self.frames = self.known = self.slow = 0
        self.foreign: dict[int, int] = {}
        self.first_s = self.earliest_s = math.inf
        self.latest_s = -math.inf
        self.off_grid = 0.0
        self.back_s = self.back_at_s = self.ahead_s = self.ahead_at_s = 0.0
        self._last_s: float | None = None

    def count_foreign(self, can_id: int, frames: int) -> None:
        """Frames of an id that the folder does not know."""
        if frames:
            self.foreign[can_id] = self.foreign.get(can_id, 0) + frames

    def take(self, piece: Piece, known: Array, dt_s: float) -> None:
        """Take in a piece's stamps. known: which of its frames are the vehicle's."""
        time_s = piece.time_s
        self.first_s = min(self.first_s, float(time_s[0])) if not self.frames else self.first_s
        self.frames += len(time_s)
        self.known += int(known.sum())
        ticks = time_s / dt_s
        self.off_grid = max(self.off_grid, float(np.abs(ticks - np.rint(ticks)).max()))
        self.earliest_s = min(self.earliest_s, float(time_s.min()))
        self.latest_s = max(self.latest_s, float(time_s.max()))
        self._step(time_s[known])

    def _step(self, time_s: Array) -> None:
        """Follow the clock from one frame of the vehicle to the next."""
        if not len(time_s):
            return
        before = time_s[0] if self._last_s is None else self._last_s
        steps = np.diff(time_s, prepend=before)
        low, high = int(steps.argmin()), int(steps.argmax())
        if -steps[low] > self.back_s:
            self.back_s, self.back_at_s = float(-steps[low]), float(time_s[low])
        if steps[high] > self.ahead_s:
            self.ahead_s, self.ahead_at_s = float(steps[high]), float(time_s[high])
        self.slow += int((steps > SLOW_S).sum())
        self._last_s = float(time_s[-1])


def place(ears: Iterable[Ear], dt_s: float, zero_s: float, late_ticks: int) -> Grid:
    """Everything heard on ticks: k = round((stamp - zero_s) / dt_s), late_ticks more for a report (episode/columns.py).

    As many rows as the last frame of the vehicle needs. What was stamped before tick 0 is left out. A field of which
    nothing is left is absent.
    """
    ears = [ear for ear in ears if ear.frames]
    late = {ear: late_ticks if ear.message.kind == TELEMETRY else 0 for ear in ears}
    last = max(round((ear.latest_s - zero_s) / dt_s) + late[ear] for ear in ears) + 1
    grid = Grid({}, {}, np.ones(max(0, last), dtype=bool))
    for ear in ears:
        for name, column in ear.columns().items():
            rows, values = _newest(column, dt_s, zero_s, late[ear])
            if len(rows):
                grid.fields[name], grid.fresh[name] = _held(rows, values, last)
    for ear, obeys in _who_says(ears):
        rows, values = _newest(obeys, dt_s, zero_s, late[ear])
        held, _ = _held(rows, values, last)
        grid.enabled[:] &= held == 1.0  # not before its first report
    return grid


def _who_says(ears: list[Ear]) -> list[tuple[Ear, Column]]:
    """Those that say `enabled`; where none does, those that say what disables."""
    for which in ("enables", "disables"):
        found = [(ear, column) for ear in ears if (column := ear.obeys(which)) is not None]
        if found:
            return found
    return []


def _newest(column: Column, dt_s: float, zero_s: float, late_ticks: int) -> tuple[Array, Array]:
    """(row, value) of the last frame in each tick that has one."""
    k = np.rint((column.time_s - zero_s) / dt_s).astype(np.int64)
    inside = k >= 0
    k, values = k[inside] + late_ticks, column.values[inside]
    order = np.argsort(k, kind="stable")
    k, values = k[order], values[order]
    newest = np.diff(k, append=k[-1] + 1 if len(k) else 0) > 0
    return k[newest], values[newest]


def _held(rows: Array, values: Array, ticks: int) -> tuple[Array, Array]:
    """(the value held until the next, NaN before the first; where it came)."""
    fresh = np.zeros(ticks, dtype=bool)
    fresh[rows] = True
    number = np.cumsum(fresh) - 1
    return np.where(number >= 0, values[np.maximum(number, 0)], np.nan) if len(rows) else np.full(ticks, np.nan), fresh
