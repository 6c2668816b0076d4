"""Whether a car forgets within WARM_S what it did before, so that a drive may be begun anew so long before a block.

Free runs over blocks that choose (gap/pays.py) drive no more of a recording than they must. What is behind a dead time
or a lag is forgotten after a few of them; play and dry friction keep where they last came from, brakes their heat, a
learned cell what it likes. Nothing is taken on trust: every part is driven far to one side and far to the other, then
held at rest, and must say the same.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tunefree_hil.base.contracts import Port
from tunefree_hil.base.kernel import Block
from tunefree_hil.base.records import Ins, Report
from tunefree_hil.plant.body import ChassisParams

WARM_S = 3.0  # a lag of 0.4 s has 5e-4 left of where it was then; most are a few hundredths
AWAY_S, AWAY = 3.0, 0.5  # how long and how far (duty, rad; 1 of what is reported) it is driven before
SAME = 1e-3  # of the difference before: what is left of it after WARM_S
FRAMES = {Port.REPORT: Report, Port.INS: Ins}


def is_forgotten(made: Any, port: Port | None, rest: float, dt_s: float) -> bool:
    """Whether an effect (what make_effect gave) or a channel (port None) forgets. Body changes are the chassis's."""
    if not isinstance(made, Block):
        return True
    record = FRAMES.get(port) if port is not None else None
    said = []
    for side in (-AWAY, AWAY):
        away, still = (_value(record, one) for one in (rest + side, rest))
        state = made.init(made.params, dt_s)
        out: Any = still
        for x, ticks in ((away, round(AWAY_S / dt_s)), (still, round(WARM_S / dt_s))):
            for _ in range(ticks):
                state, out = made.step(made.params, state, x, dt_s)
        said.append(np.asarray(out, dtype=float))
    return bool(np.abs(said[0] - said[1]).max() <= SAME * 2.0 * AWAY)


def chassis_forgets(kind: str, params: ChassisParams) -> bool:
    """Whether a chassis that is told its motion has no other past: the physics, as long as its brakes do not fade."""
    return kind == "physics" and params.constants.brake_loss_per_j == 0.0


def needed(held: np.ndarray, dt_s: float) -> np.ndarray:
    """Rows of a drive [n] that are free, or no more than WARM_S before one that is."""
    reach = round(WARM_S / dt_s)
    ahead = np.concatenate([np.cumsum(~held), np.full(reach + 1, int((~held).sum()))])
    before = np.concatenate([[0], ahead[: len(held)][:-1]])
    return ahead[reach : reach + len(held)] > before


def _value(record: Any, value: float) -> Any:
    return value if record is None else record(*(value,) * len(record._fields))
