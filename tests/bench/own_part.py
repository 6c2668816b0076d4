"""A controller part of the user's own beside a bench file, for the tests of bench and jobs."""

from __future__ import annotations

from pathlib import Path

from tests.bench.tiny import write_bench

PART = """
from typing import NamedTuple

from tunefree_hil.base.contracts import Block, Tunable
from tunefree_hil.base.kernel import kernel


class Params(NamedTuple):
    gain: float = 2.0


def init(params, dt_s):
    return 0.0


@kernel
def step(params, state, x, dt_s):
    tracking, measurement = x
    return state, -params.gain * (tracking.lateral_error_m + 2.0 * tracking.heading_error_rad)


CONTROLLER = Block(init, step, Params(), (Tunable("mine.gain", "rad/m", 0.1, 10.0),))
"""


def write_own(folder: Path, more: str = "", part: str = PART, duration_s: float = 2.0) -> Path:
    """A bench file whose lateral part is `part`, in a file beside it; `more`: further lines of [controller]."""
    (folder / "mine.py").write_text(part)
    return write_bench(folder, duration_s=duration_s, more=f'[controller]\nlateral = "mine.py:CONTROLLER"\n{more}\n')
