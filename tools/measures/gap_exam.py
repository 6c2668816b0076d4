"""Does `gap` name what a simulation lacks? Its exam: new cars, one effect hidden in a log, or two, or none, or another.

The exam of a commit (tools/gap_exam) is begun or gone on with, then counted, however far it is; of several parts each
may be asked by a call of its own. The first exam after a freeze is the headline; later ones are pooled with it.
"""

from __future__ import annotations

from typing import Any

from tools.measures._gap_exam import HOURS, RECORDINGS, RUN, Asked, answer_of, asked, there_is_gap

VALUE = "percent of detectable one-effect logs of unseen vehicles in which gap names the effect, alone and right"
ROW = "one effect, detectable"


def measure(
    run: str = RUN,
    domain: str = "",
    rows: str = "",
    part: str = "1/1",
    logs: int = 0,
    hours: float = HOURS,
    recordings: str = RECORDINGS,
    beside: int = 24,
    pool: str = "",
    unfrozen: int = 0,
) -> dict[str, Any]:
    """run: folder, gone on with where it is there. domain: '' exam:HEAD. rows: '' all. part: K/N. logs: 0 all of these.

    hours: after which nothing more is asked. beside: so many are compared with a plain LSTM residual on the same data.
    pool: comma-separated folders of later exams. unfrozen: 1 asks a checkout that is not the commit's, and says so. Of
    a run that is not whole the answer is what there is; n, and `done` in detail, say how much.
    """
    there_is_gap()
    detail = asked(
        Asked(run, domain, rows, part, logs, hours, recordings, False, bool(unfrozen), beside), *pool_of(pool)
    )
    return answer_of(detail, ROW)


def pool_of(words: str) -> list[str]:
    """Folders, comma-separated."""
    return [word for word in words.split(",") if word]
