"""What an answer says beside its verdict: that a short recording was judged by few blocks."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from tunefree_hil.gap.measured.blocks import HOLDOUT, cut_blocks
from tunefree_hil.gap.pipeline import Diagnosis
from tunefree_hil.gap.result import FEW_BLOCKS, _few_blocks_texts
from tunefree_hil.gap.selection.reasons import Verdict, VerdictKind


def found(seconds: float, verdict: str) -> Diagnosis:
    blocks = cut_blocks([round(seconds / 0.01)], 0.01)
    return cast(
        Diagnosis,
        cast(Any, SimpleNamespace(problem=SimpleNamespace(blocks=blocks), verdict=Verdict(VerdictKind(verdict)))),
    )


@pytest.mark.parametrize(("seconds", "verdict", "said"), [
    (60.0, "one", True), (75.0, "none_missing", True), (180.0, "one", False), (60.0, "none_of_these", False),
])  # fmt: skip
def test_few_blocks_are_said_where_the_verdict_stands_on_nothing_else_being_seen(
    seconds: float, verdict: str, said: bool
) -> None:
    asked = found(seconds, verdict)
    judged = int((asked.problem.blocks.roles != HOLDOUT).sum())
    assert (judged < FEW_BLOCKS) is (seconds < 100.0)
    words = _few_blocks_texts(asked)
    assert bool(words) is said and all(str(judged) in one for one in words)
