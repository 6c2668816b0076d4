"""The pictures of an exam: outcomes by row, and how small an effect may be."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tools.gap_exam.limits import Limit
from tools.gap_exam.outcomes import OUTCOMES
from tools.gap_exam.score import Row
from tools.gap_exam.words import ARROW, label, limit_words, plain

COLOURS = {"right": "#2a7f62", "in_set": "#9ccc9c", "partial": "#f2c45a", "silent": "#b8bcc4", "wrong": "#c0392b",
           "cannot_test": "#7f8fa6", "failed": "#2f3640"}  # fmt: skip
MEANT = (
    "right: the effects and only they; nothing where nothing is hidden, no name on originals. in set: a set with the "
    "truth in it. partial: of two effects one, nothing false.\nsilent: no name on a log with an effect. wrong: any "
    "false name. cannot test: it says so. failed: no answer. *: logs share models, and the intervals draw whole models."
)
DOWN = f"{ARROW}: the smaller the value, the grosser the effect"
STATED = ("right", "wrong")  # outcomes whose intervals stand beside the bars
BESIDE = (0.0, 0.55)  # where: of the room there
SHADES = (0.15, 0.9)  # of the dots: none, all were named
DOT = {"markersize": 7, "markeredgecolor": "#888888", "markeredgewidth": 0.5}
COMMIT = re.compile(r"exam:([0-9a-f]{12})[0-9a-f]{28}")
SHORT = 7  # of a commit, where several are named


def heading(domain: str, done: Sequence[str]) -> str:
    """What a picture is of: 'Exam of commit 0123456789ab; logs: 504 of 1281 done'; of several in short."""
    if len(done) > 1:
        short = ", ".join(COMMIT.sub(lambda found: found[1][:SHORT], name) for name in domain.split(" and "))
        return f"{len(done)} exams ({short}); logs: {sum(int(one.split()[0]) for one in done)}"
    name = COMMIT.sub("commit \\1", domain)
    return f"Exam of {name}; logs: {done[0]}" if done else f"Exam of {name}"


def draw_outcomes(path: Path, rows: Sequence[Row], title: str) -> None:
    """A bar a row, its outcomes in shares; beside it how many are right and wrong, with their intervals."""
    plt = _plotter()
    size = (13.0, 0.3 * len(rows) + 1.9)
    figure, (axes, beside) = plt.subplots(1, 2, figsize=size, layout="constrained", width_ratios=(5, 3), sharey=True)
    left = [0.0] * len(rows)
    for name in OUTCOMES:
        shares = [100.0 * row.outcomes[name] / row.n for row in rows]
        axes.barh(range(len(rows)), shares, left=left, color=COLOURS[name], label=name.replace("_", " "), height=0.72)
        left = [a + b for a, b in zip(left, shares, strict=True)]
    for place, row in enumerate(rows):
        for name, at in zip(STATED, BESIDE, strict=True):
            beside.text(at, place, _interval(row, name), va="center", fontsize=8)
    axes.set_yticks(range(len(rows)), [_row_label(row) for row in rows], fontsize=8)
    axes.set_xlim(0.0, 100.0)
    axes.set_xlabel("share of logs [%]")
    axes.legend(ncols=len(OUTCOMES), loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8)
    _finish(figure, axes, beside, title, len(rows))
    for name, at in zip(STATED, BESIDE, strict=True):
        beside.text(at, -0.9, f"{name} [%] (95 % interval)", fontsize=8, fontweight="bold")
    figure.supxlabel(MEANT, x=0.01, ha="left", fontsize=7)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _row_label(row: Row) -> str:
    counts = [f"{n} {word}{'' if n == 1 else 's'}" for n, word in ((row.n, "log"), (row.models, "model"))]
    return f"{row.name} ({', '.join(counts)}{'*' if row.whole else ''})"


def _interval(row: Row, name: str) -> str:
    """'88.7 (82.5 to 92.9)', in percent; nothing of a row whose figures are others."""
    if name not in row.figures:
        return ""
    value, low, high = (plain(100.0 * (one or 0.0)) for one in row.figures[name][:3])
    return f"{value} ({low} to {high})"


def draw_limits(path: Path, limits: Sequence[Limit], title: str) -> None:
    """For every effect the sizes that were asked, darker the more were named, and where 90 % are, with its interval."""
    plt = _plotter()
    size = (11.0, 0.25 * len(limits) + 2.0)
    figure, (axes, beside) = plt.subplots(1, 2, figsize=size, layout="constrained", width_ratios=(5, 2), sharey=True)
    for place, one in enumerate(limits):
        for at, _, named, logs in one.steps:
            axes.plot(at, place, "o", color=_shade(plt, named / logs), **DOT)
        _draw_interval(axes, place, one)
        beside.text(0.0, place, limit_words(one), va="center", fontsize=8)
    axes.set_yticks(range(len(limits)), [label(one.name) for one in limits], fontsize=8)
    axes.set_xlim(-0.06, 1.06)
    axes.set_xticks([0.0, 0.5, 1.0], ["just noticeable", "", "gross"])
    axes.set_xlabel(f"size of the effect ({DOWN})")
    some = _legend(plt, axes)
    axes.legend(handles=some, ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0), frameon=False, fontsize=8)
    _finish(figure, axes, beside, f"How small an effect may be and still be named. {title}", len(limits))
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _draw_interval(axes: Any, place: int, one: Limit) -> None:
    """The thin line within the sizes asked, an arrow at an open end, and the thick tick where the value is."""
    middle, low, high = one.at
    axes.plot([low, high], [place, place], color="black", linewidth=0.8, zorder=0)
    for edge, at, marker in ((one.low, low, "<"), (one.high, high, ">")):
        if edge is None and not (one.value is None and marker == "<"):  # what is never named is open upwards
            axes.plot(at + (-0.018 if marker == "<" else 0.018), place, marker, color="black", markersize=4)
    if one.value is not None:
        axes.plot([middle, middle], [place - 0.35, place + 0.35], color="black", linewidth=2.0)


def _legend(plt: Any, axes: Any) -> list[Any]:
    """Every mark of the picture, drawn outside of it."""
    none, tick = [], {"color": "black", "linestyle": "none"}
    return [
        axes.plot(
            none,
            none,
            marker="|",
            markersize=10,
            markeredgewidth=2.0,
            label="named in 90 % of logs from here on",
            **tick,
        )[0],
        axes.plot(none, none, color="black", linewidth=0.8, label="its 95 % interval, within the sizes asked")[0],
        axes.plot(none, none, marker=">", markersize=4, label="open: nothing was asked beyond", **tick)[0],
        axes.plot(none, none, "o", color=_shade(plt, 1.0), label="logs of a size: all named", **DOT)[0],
        axes.plot(none, none, "o", color=_shade(plt, 0.5), label="half of them", **DOT)[0],
        axes.plot(none, none, "o", color=_shade(plt, 0.0), label="none of them", **DOT)[0],
    ]


def _shade(plt: Any, share: float) -> Any:
    return plt.cm.Greens(SHADES[0] + (SHADES[1] - SHADES[0]) * share)


def _finish(figure: Any, axes: Any, beside: Any, title: str, rows: int) -> None:
    """Rows from the top down, a title over all, and room for words on the right."""
    axes.set_ylim(rows - 0.4, -0.6)
    axes.spines[["top", "right"]].set_visible(False)
    beside.set_axis_off()
    figure.suptitle(title, x=0.01, ha="left", fontsize=10)


def _plotter() -> Any:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt
