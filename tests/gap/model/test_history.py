"""Signals moved in time, and what a drive gave a moment ago."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from tunefree_hil.gap.model.history import MAX_RESULTS, ResultCache, shift_earlier


def test_a_signal_is_moved_ahead_by_parts_of_a_row() -> None:
    values = np.arange(10.0)
    assert shift_earlier(values, 1.5)[:8] == pytest.approx(values[:8] + 1.5)
    assert shift_earlier(values, -2.0)[2:] == pytest.approx(values[:8])
    assert shift_earlier(np.column_stack([values, 2.0 * values]), 0.5)[3] == pytest.approx([3.5, 7.0])
    assert np.array_equal(shift_earlier(values, 0.0), values) and np.array_equal(
        shift_earlier(values, 40.0), np.full(10, 9.0)
    )


def test_a_result_is_found_for_the_very_drive_and_values_only() -> None:
    one, other, recent = SimpleNamespace(), SimpleNamespace(), ResultCache()
    result = recent.store(one, {"a": 1.0, "b": 2.0}, np.arange(3.0))
    assert recent.get(one, {"b": 2.0, "a": 1.0}) is result
    assert recent.get(other, {"a": 1.0, "b": 2.0}) is None and recent.get(one, {"a": 1.0}) is None


def test_the_result_asked_for_longest_ago_is_forgotten_and_other_drives_keep_theirs() -> None:
    one, other, recent = SimpleNamespace(), SimpleNamespace(), ResultCache()
    recent.store(other, {}, np.zeros(1))
    for k in range(MAX_RESULTS):
        recent.store(one, {"a": float(k)}, np.zeros(1))
    assert recent.get(one, {"a": 0.0}) is not None  # asked for again: the next is the oldest now
    recent.store(one, {"a": 99.0}, np.zeros(1))
    assert recent.get(one, {"a": 1.0}) is None and recent.get(one, {"a": 0.0}) is not None
    assert recent.get(other, {}) is not None
