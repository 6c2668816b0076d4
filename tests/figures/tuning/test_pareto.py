"""The picture of two objectives: what it names, what it leaves out, and that no names lie over each other."""

from __future__ import annotations

from itertools import combinations

import pytest

from tunefree_hil.figures.tuning.pareto import FrontPicture, draw_front

PICTURE = FrontPicture(
    trials=[(0.2, 0.17), (0.28, 0.13), (0.6, 0.12), (0.5, 0.15), (0.3, 0.2), (10.0, 10.0)],
    is_met=[True, True, True, True, False, False],
    front=[(0.2, 0.17), (0.28, 0.13), (0.6, 0.12)],
    manual={"mrac_on": (0.317, 0.147), "as_shipped": (0.314, 0.148), "rule_based": (0.318, 0.146), "far": (0.61, 0.14)},
    reference="mrac_on",
    winner=(0.28, 0.13),
)
LABELS = ("tracking cost", "comfort cost")


def labels_of(picture: FrontPicture) -> list[str]:
    return draw_front(picture, LABELS, "title").axes[0].get_legend_handles_labels()[1]


def test_it_names_what_it_shows() -> None:
    figure = draw_front(PICTURE, LABELS, "The winner")
    (axes,) = figure.axes
    assert {text.get_text() for text in axes.texts} == set(PICTURE.manual)
    assert (axes.get_xlabel(), axes.get_ylabel()) == LABELS
    assert {axes.get_xscale(), axes.get_yscale()} == {"log"}
    assert {"Pareto front, 3 trials", "winner", "manual set", "better than mrac_on in both"} <= set(labels_of(PICTURE))
    hollow, full = axes.collections[-2:]
    assert len(hollow.get_offsets()) == 1 and len(full.get_offsets()) == 4  # type: ignore[arg-type]
    assert hollow.get_facecolor().size == 0 and full.get_facecolor().size > 0  # type: ignore[union-attr]


def test_failed_drives_are_counted_and_leave_room_for_the_others() -> None:
    (axes,) = draw_front(PICTURE, LABELS, "t").axes
    assert axes.get_title(loc="left") == "1 trials lie beyond the picture" and axes.get_xlim()[1] < 1.0
    (axes,) = draw_front(PICTURE._replace(trials=PICTURE.trials[:5], is_met=[True] * 5), LABELS, "t").axes
    assert axes.get_title(loc="left") == ""


def test_without_requirements_a_trial_is_a_trial() -> None:
    shown = labels_of(PICTURE._replace(is_met=[True] * 6))
    assert "trial" in shown and not any("requirement" in label for label in shown)


@pytest.mark.parametrize("front", [PICTURE.front, PICTURE.front[:1]])
def test_names_do_not_overlap_and_stay_inside(front: list[tuple[float, float]]) -> None:
    figure = draw_front(PICTURE._replace(front=front), LABELS, "t")
    figure.canvas.draw()
    boxes = [text.get_window_extent() for text in figure.axes[0].texts]
    assert not any(first.overlaps(second) for first, second in combinations(boxes, 2))
    assert all(box.x0 >= 0 and box.x1 <= figure.bbox.width for box in boxes)
