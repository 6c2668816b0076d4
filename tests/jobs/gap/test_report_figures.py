"""Which block of a proof is shown."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.gap.made_answer import VEHICLE, late_drive, made_kept, made_model
from tunefree_hil.gap.measured.chain import build_measured_drive
from tunefree_hil.gap.validation.block_runs import BlockTrace, Variant, run_blocks
from tunefree_hil.gap.validation.gap_closed import error_floors, signal_gaps
from tunefree_hil.jobs.gap.report_figures import draw_figures, select_block

T = np.linspace(0.0, 8.0, 81)


def block(missed: float, name: str = "report.brake_frac") -> BlockTrace:
    return BlockTrace(T, {name: 0.0 * T}, {"before": {name: 9.0 + T}, "recalibrated": {name: missed * np.sin(T)}})


def test_the_block_that_shows_most_of_what_is_missed_is_shown() -> None:
    some = [block(0.001), block(0.2), block(0.1)]
    assert select_block(some, ("report.brake_frac",)) is some[1]
    assert select_block(some, ("ins.speed_mps", "report.brake_frac")) is some[1], "the first that was measured"


def test_where_the_signal_was_not_measured_it_is_the_first_block() -> None:
    some = [block(0.1), block(0.2)]
    assert select_block(some, ("ins.speed_mps",)) is some[0] and select_block(some, ()) is some[0]


def test_where_it_is_not_known_what_the_steering_did_its_motion_is_not_drawn(tmp_path: Path) -> None:
    """A log of INS and pedals alone: no run can come to a yaw rate, and no gap of one is told."""
    drive = late_drive()
    gone = {name: one for name, one in drive.fields.items() if "steer" not in name and "report.yaw" not in name}
    opened = build_measured_drive(drive._replace(fields=gone), VEHICLE)
    assert opened.unknown_channels == {"steer"}
    proof = run_blocks({"before": Variant(made_model()), "recalibrated": Variant(made_model())}, VEHICLE, [opened])
    signals = {name: one._asdict() for name, one in signal_gaps(proof, error_floors(proof, made_model()), {}).items()}
    assert "ins.yaw_rate_radps" not in signals and proof.n_blocks
    kept = made_kept("none_missing")
    drawn = draw_figures(tmp_path, {**kept.answer, "signals": signals}, kept, proof)
    assert {"traces.png", "shrink.png"} <= {one.name for one in drawn}
