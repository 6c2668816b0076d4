"""Fig. 11: lateral and speed error over time with manual and with tuned parameters, three manoeuvres."""

from __future__ import annotations

import numpy as np

from tools.reproduction.context import COMPLETE_BENCH, Context
from tools.reproduction.fig8 import SEARCHES
from tools.reproduction.fig10 import complete_setting
from tools.reproduction.figures.errors import ErrorPanel, draw_errors
from tools.reproduction.records import Claim, Method, Record, Value
from tools.reproduction.searches import SearchBench
from tunefree_hil.bench import parameters_of
from tunefree_hil.bench.batch import Driven, Job

NAME = "fig11"
CASES = {"side_pass": "side-pass", "right_turn": "right turn", "u_turn": "U-turn"}
SIGNALS = {"lateral_error_m": ("lateral error", "m"), "speed_error_mps": ("speed error", "m/s")}


def reproduce(context: Context) -> Record:
    """Drive the three manoeuvres with both sets."""
    with SearchBench(COMPLETE_BENCH, context.folders.work / SEARCHES) as bench:
        setting = complete_setting(context)
        result = bench.search(setting, lambda done: context.progress.update(done / setting.trials, f"trial {done}"))
        sets = {"manual": bench.manual(), "tuned": parameters_of(bench.bench, result.winner.parameters)}
        jobs = [Job(values, bench.bench.scenarios[case]) for values in sets.values() for case in CASES]
        drives = bench.batch.drive(jobs, columns=True)
        manual_score = bench.score_manual()
    pairs = dict(zip(CASES, zip(drives[: len(CASES)], drives[len(CASES) :], strict=True), strict=True))
    panels = [
        ErrorPanel(f"Case {number}: {CASES[case]}", name, unit, *(_series(drive, column) for drive in pair))
        for number, (case, pair) in enumerate(pairs.items(), 1)
        for column, (name, unit) in SIGNALS.items()
    ]
    lower = sum(panel.rms_tuned < panel.rms_manual for panel in panels)
    return Record(
        name=NAME,
        title="Manual and auto-tuned control, 11 parameters",
        paper="Fig. 11: lateral and speed error over time of side-pass, right turn and U-turn in simulation, manual "
        "against auto-tuned (11 parameters); the tuned errors are smaller. Pictures without numbers.",
        claim=Claim("The tuned set has the smaller RMS error in all six panels.", lower == len(panels)),
        values=(
            *(Value(f"{panel.title}, {panel.name}", _change_text(panel)) for panel in panels),
            Value("score of the seven scenarios", f"{manual_score:.3f} to {result.winner.score:.3f}"),
        ),
        method=Method(
            f"{COMPLETE_BENCH}, on its plant",
            f"1 drive a panel and set, winner of {setting.trials} trials",
            f"search {setting.seed}",
            "Compiled batch; the drives are scenarios of the search, as in the paper. The tuned set is that of "
            "the longest search of Fig. 10.",
        ),
        difference="The paper drives its learned plant, we the bench's. The manual set is the published one, with "
        "MRAC on, and was made for the plant of this data sheet.",
        figures=(context.save(draw_errors(panels), NAME),),
        detail={"tuned": dict(result.winner.parameters)},
    )


def _change_text(panel: ErrorPanel) -> str:
    change = 100.0 * (panel.rms_tuned / panel.rms_manual - 1.0)
    return f"RMS {panel.rms_manual:.3f} to {panel.rms_tuned:.3f} {panel.unit} ({change:+.0f} %)"


def _series(drive: Driven, column: str) -> tuple[np.ndarray, np.ndarray]:
    """Time and signal of a drive."""
    assert drive.recording is not None
    return np.asarray(drive.recording.columns["t_s"]), np.asarray(drive.recording.columns[column])
