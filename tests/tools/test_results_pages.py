"""The pages of docs/results/ say what their CSV files say, and README quotes them."""

from __future__ import annotations

import csv
import re

from tests.house import ROOT
from tools import make_criteria_page, make_results_page


def test_pages_are_generated_from_their_tables() -> None:
    for name, text in make_results_page.pages().items():
        assert (make_results_page.FOLDER / name).read_text(encoding="utf-8") == text, "run tools/make_results_page.py"


def test_the_page_of_criteria_is_generated() -> None:
    assert make_criteria_page.PAGE.read_text(encoding="utf-8") == make_criteria_page.page(), (
        "run tools/make_criteria_page.py"
    )


def test_every_threshold_says_what_it_means() -> None:
    silent = [(r.file, r.name, t.name) for r in make_criteria_page.records() for t in r.thresholds if not t.meaning]
    assert silent == []


def test_figures_name_measures_that_exist() -> None:
    with (make_results_page.FOLDER / "figures.csv").open(encoding="utf-8", newline="") as file:
        named = {row["measure"] for row in csv.DictReader(file)}
    there = {path.stem for path in (ROOT / "tools" / "measures").glob("*.py")}
    assert named <= there


def test_readme_quotes_figures_that_are_recorded() -> None:
    with (make_results_page.FOLDER / "figures.csv").open(encoding="utf-8", newline="") as file:
        recorded = {(row["measure"], row["value"]) for row in csv.DictReader(file)}
    with (make_results_page.FOLDER / "gap_exam.csv").open(encoding="utf-8", newline="") as file:
        recorded |= {("gap_exam", row["first_whole_exam_fb4a7b1"]) for row in csv.DictReader(file)}
    rows = re.findall(r"^\| `(\w+)` \| .* \| (.+?) \|$", (ROOT / "README.md").read_text(), re.MULTILINE)
    assert len(rows) == 10
    assert set(rows) <= recorded, "README quotes a figure that docs/results/ does not record"
