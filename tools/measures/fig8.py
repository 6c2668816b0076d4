"""How near to each other searches with GPR and TPE end: MRAC's two parameters, eight settings (paper, Fig. 8a)."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from tools.measures._summary import machine, rounded
from tools.reproduction.context import STEER_BENCH, work_folder
from tools.reproduction.fig8 import SEARCHES, search_all, settings, trials_sum

VALUE = "percent by which the worst winner of 8 settings (surrogate, acquisition, trials) scores above the best; aim 3"


def measure(seed: int = 1, quick: int = 0, bench: str = STEER_BENCH, folder: str = "") -> dict[str, Any]:
    """Search with every setting, in the batch on the bench file's model; low and high are the least and the largest.

    quick: 1 for a tenth of the trials. folder: '' is that of tools/reproduce, so that its searches are used.
    """
    before = machine()
    place = Path(folder) / SEARCHES if folder else work_folder(bool(quick)) / SEARCHES
    listed = settings(seed, bool(quick))
    searched = search_all(bench, place, listed, _say)
    spreads = searched.spreads_percent
    detail = {
        "machine": before,
        "bench": bench,
        "trials": trials_sum(searched),
        "manual": {"score": searched.manual_score, "parameters": searched.manual},
        "winners": [
            {**result.setting._asdict(), **result.winner.parameters, "score": result.winner.score}
            for result in searched.results
        ],
        "not_installed": [setting.label for setting in searched.missing],
    }
    return {
        "value": max(spreads),
        "unit": "percent",
        "n": len(spreads),
        "low": min(spreads),
        "high": max(spreads),
        "detail": rounded(detail),
    }


def _say(share: float, text: str) -> None:
    print(f"fig8 {100.0 * share:.0f} %: {text}", file=sys.stderr, flush=True)
