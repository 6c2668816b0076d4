"""How long `gap` takes for a recording of ten minutes: whole catalogue, repair and proof, two processes.

The cars and effects are development's (tools/gap_exam), one log after the other, on a machine with nothing else to do.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tools.gap_exam.files import Run, read_json
from tools.gap_exam.prepare import begin
from tools.gap_exam.rows import Exam, sample_of
from tools.gap_exam.runner import Examiner, Program
from tools.gap_exam.seeds import DEVELOPMENT, Domain
from tools.measures._gap_exam import code_hash, there_is_gap
from tunefree_hil.base.errors import InputError

VALUE = "median seconds that gap takes for a log of 10 minutes, whole catalogue with repair and proof, 2 processes"
MINUTES = 10.0
WHOLE = "tunefree-hil gap {log} --vehicle {vehicle} --model {model} --out {out} --json"


def measure(run: str = "", logs: int = 3) -> dict[str, Any]:
    """run: '' a folder of this state of the package, which is gone on with. logs: how many, of as many effects."""
    there_is_gap()
    exam, folder = long_logs(logs), Run(Path(run or f"runs/gap_time/{code_hash()}"))
    begin(folder, exam, sample=True)
    Examiner(folder, exam, Program(gap=WHOLE)).go(exam.cases, parallel=1)
    unanswered = [case.number for case in exam.cases if not (folder.answer(case.number) / "gap.json").is_file()]
    if unanswered:
        raise InputError(f"no answer to {unanswered}", code="exam", key="--run", hint=f"see {folder.folder}/answers")
    found = {case.number: read_json(folder.answer(case.number) / "run.json") for case in exam.cases}
    seconds = [one["seconds"] for one in found.values()]
    return {
        "value": float(np.median(seconds)),
        "unit": "s",
        "n": len(seconds),
        "low": min(seconds),
        "high": max(seconds),
        "detail": {f"{number:04d}": {key: one[key] for key in ("seconds", "status")} for number, one in found.items()},
    }


def long_logs(logs: int) -> Exam:
    """The first so many of a sample, each as long as MINUTES."""
    exam = sample_of(Domain(DEVELOPMENT, "time"))
    return exam._replace(cases=tuple(case._replace(duration_s=60.0 * MINUTES) for case in exam.cases[:logs]))
