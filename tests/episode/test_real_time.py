"""Tick 0 of a real-time drive: the runner's first RUN in the bench's log."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.episode.candump import BLOCK_BYTES
from tunefree_hil.episode.real_time import run_zero_s


def line(time_s: float, message: bc.Status | bc.Tick) -> str:
    frame = bc.encode(message)
    return f"({time_s:.6f}) bench {frame.id:03X}#{frame.data.hex().upper()}\n"


def status(role: bc.Role, state: bc.State, lead_ms: int = 0) -> bc.Status:
    return bc.Status(role, state, 0, lead_ms)


BEFORE = (
    (1.0, status(bc.Role.RUNNER, bc.State.LOADING, 900)),
    (1.1, status(bc.Role.ECU, bc.State.RUN, 800)),
    (1.2, bc.Tick(3)),
)
RUN = status(bc.Role.RUNNER, bc.State.RUN, 500)


def log_of(folder: Path, lines: Sequence[str]) -> Path:
    path = folder / "bench.log"
    path.write_text("".join(lines))
    return path


@given(micro=st.integers(0, 2 * 10**15), lead_ms=st.integers(0, 60_000))
def test_the_stamp_of_run_and_its_lead(tmp_path_factory: pytest.TempPathFactory, micro: int, lead_ms: int) -> None:
    lines = [line(0.0, bc.Tick(1)), line(micro * 1e-6, status(bc.Role.RUNNER, bc.State.RUN, lead_ms))]
    path = log_of(tmp_path_factory.mktemp("bench"), lines)
    assert run_zero_s(path) == pytest.approx(micro * 1e-6 + lead_ms * 1e-3, abs=2e-6)


def test_only_the_runners_run_counts_and_the_first_of_them(tmp_path: Path) -> None:
    lines = [*(line(*one) for one in BEFORE), "(1.250000) bench 6E2#00\n", line(1.3, RUN), line(9.0, RUN)]
    assert run_zero_s(log_of(tmp_path, lines)) == pytest.approx(1.8)


def test_a_log_that_was_cut_off_after_it_will_do(tmp_path: Path) -> None:
    assert run_zero_s(log_of(tmp_path, [line(1.3, RUN), "(2.00"])) == pytest.approx(1.8)


@pytest.mark.slow
def test_it_is_read_no_further_than_needed(tmp_path: Path) -> None:
    more = line(1.4, bc.Tick(1))
    count = BLOCK_BYTES // len(more) + 2
    assert run_zero_s(log_of(tmp_path, [line(1.3, RUN), more * count, "spoilt\n"])) == pytest.approx(1.8)
    with pytest.raises(InputError, match="not a frame"):
        run_zero_s(log_of(tmp_path, [more * count, "spoilt\n", line(1.3, RUN)]))


def test_a_drive_that_never_began(tmp_path: Path) -> None:
    path = log_of(tmp_path, [line(*one) for one in BEFORE])
    with pytest.raises(InputError, match="no RUN") as caught:
        run_zero_s(path)
    assert (caught.value.code, caught.value.file) == ("no_run", str(path)) and caught.value.hint
    with pytest.raises(InputError, match="empty"):
        run_zero_s(log_of(tmp_path, []))
    with pytest.raises(InputError, match="no such log"):
        run_zero_s(tmp_path / "none.log")
