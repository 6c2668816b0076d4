"""What an answer says beside its verdict: that a short recording was judged by few blocks."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from tunefree_hil.gap.measured.blocks import PROOF, blocks_of
from tunefree_hil.gap.pipeline import Named
from tunefree_hil.gap.result import FEW_BLOCKS, _short_words


def found(seconds: float, verdict: str) -> Named:
    blocks = blocks_of([round(seconds / 0.01)], 0.01)
    return cast(Named, cast(Any, SimpleNamespace(question=SimpleNamespace(blocks=blocks), verdict=verdict)))


@pytest.mark.parametrize(("seconds", "verdict", "said"), [
    (60.0, "one", True), (75.0, "none_missing", True), (180.0, "one", False), (60.0, "none_of_these", False),
])  # fmt: skip
def test_few_blocks_are_said_where_the_verdict_stands_on_nothing_else_being_seen(
    seconds: float, verdict: str, said: bool
) -> None:
    asked = found(seconds, verdict)
    judged = int((asked.question.blocks.roles != PROOF).sum())
    assert (judged < FEW_BLOCKS) is (seconds < 100.0)
    words = _short_words(asked)
    assert bool(words) is said and all(str(judged) in one for one in words)
