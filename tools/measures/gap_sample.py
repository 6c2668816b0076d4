"""A small exam of `gap` for every change: 24 effects, each in one log, on four cars. For CI and for a quick look.

Its cars are development's, always the same; they say whether something broke, not how good it is (`gap_exam` does).
"""

from __future__ import annotations

from typing import Any

from tools.measures._gap_exam import Asked, answer_of, asked, code_hash, there_is_gap
from tools.measures.gap_exam import ROW

VALUE = "percent of the detectable logs of 24 one-effect logs in which gap names the effect, alone and right"


def measure(run: str = "", domain: str = "dev:sample", logs: int = 0, hours: float = 1.0) -> dict[str, Any]:
    """run: '' a folder of this state of the package, so that a changed package is asked anew; it goes on if cut off."""
    there_is_gap()
    folder = run or f"runs/gap_sample/{code_hash()}"
    return answer_of(asked(Asked(folder, domain, "", "1/1", logs, hours, "", sample=True)), ROW)
