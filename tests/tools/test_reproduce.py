"""tools/reproduce: command line, records and page; the committed page says what its records say."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.house import ROOT
from tools.reproduction import runner
from tools.reproduction.context import LineRelay
from tools.reproduction.page import PAPER_ORDER, page_text, title_of
from tools.reproduction.records import Claim, Method, Origin, Record, StoredRecord, Value, read_record, write_record
from tunefree_hil.base.errors import InputError

ORIGIN = Origin("abc1234", 0, False, 12.5, 2)
METHOD = Method("bench.toml", "3 searches", "1 to 3", "In the batch.")
NUMBERS = st.floats(-1e6, 1e6, allow_nan=False)
TEXTS = st.text(st.characters(exclude_categories=("Cs", "Cc")), min_size=1, max_size=20)
VALUES = st.builds(Value, TEXTS, st.one_of(NUMBERS, TEXTS), TEXTS, TEXTS, st.none(), st.none())


def record(name: str = "fig9", *, is_met: bool = True, values: tuple[Value, ...] = ()) -> Record:
    claim = Claim("The error is smaller.", is_met)
    return Record(name, "A title", "What it shows.", claim, values, METHOD, "No road.", (f"{name}.png",), {"a": [1.5]})


def test_without_names_all_parts_run_in_an_order_that_lets_later_ones_find_what_earlier_ones_made() -> None:
    assert runner.parse([]).names == runner.NAMES
    assert runner.parse(["table3", "fig8a"]).names == ("fig8a", "table3")
    assert sorted(runner.NAMES) == sorted(PAPER_ORDER)


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["fig99"], "unknown_part"),
        (["--quick", "--out", str(ROOT / "docs" / "figures")], "quick_in_docs"),
        (["--quick", "--full"], "bad_options"),
    ],
)
def test_options_that_do_not_fit_are_refused(words: list[str], code: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError) as refused:
        runner.parse(words)
    assert refused.value.code == code and refused.value.hint
    assert runner.main(words) == 2 and "what to do" in capsys.readouterr().err


def test_a_quick_run_never_writes_into_docs() -> None:
    for words in (["--quick"], ["--quick", "--out", "elsewhere"]):
        options = runner.parse(words)
        places = (options.page(), *options.folders())
        assert not any(place.resolve().is_relative_to(ROOT / "docs") for place in places)
    assert runner.parse([]).page() == ROOT / "docs" / "results" / "reproduction.md"


@given(values=st.lists(VALUES, max_size=4), is_met=st.booleans())
def test_a_record_is_read_as_it_was_written(
    tmp_path_factory: pytest.TempPathFactory, values: list[Value], is_met: bool
) -> None:
    folder = tmp_path_factory.mktemp("records")
    written = record(is_met=is_met, values=tuple(values))
    stored = read_record(write_record(folder, written, ORIGIN))
    assert stored.origin == ORIGIN and stored.record.claim == written.claim and stored.record.method == METHOD
    assert stored.record.detail == {"a": [1.5]} and not list(folder.glob("*.part"))
    for mine, other in zip(stored.record.values, values, strict=True):
        close = pytest.approx(other.ours, rel=1e-3) if isinstance(other.ours, float) else other.ours
        assert mine.ours == close and mine[0] == other[0] and mine[2:4] == other[2:4]


def test_the_page_says_what_is_met_what_is_not_and_that_a_run_was_quick() -> None:
    good, bad = StoredRecord(record("fig9"), ORIGIN), StoredRecord(record("table4", is_met=False), ORIGIN)
    text = page_text([good, bad], "../figures/reproduction")
    assert text == page_text([good, bad], "../figures/reproduction")
    assert "![Fig. 9: A title](../figures/reproduction/fig9.png)" in text and "commit abc1234, 2 cores" in text
    assert text.count("*Not reproduced:*") == 1 and "*Not reproduced:*" in text.partition("## Table IV")[2]
    assert "- Table IV: The error is smaller." in text
    assert "Quick run" not in text
    quick = good._replace(origin=ORIGIN._replace(is_quick=True, changed_files=3))
    assert "Quick run" in page_text([quick], ".") and "with 3 changed files" in page_text([quick], ".")


def test_links_of_the_overview_lead_to_headings() -> None:
    text = page_text([StoredRecord(record(name), ORIGIN) for name in PAPER_ORDER], ".")
    headings = {
        re.sub(r"[^\w\- ]", "", line.removeprefix("## ").lower()).replace(" ", "-")
        for line in text.splitlines()
        if line.startswith("## ")
    }
    links = re.findall(r"\]\(#([^)]+)\)", text)
    assert len(links) == len(PAPER_ORDER) and set(links) <= headings


def test_parts_are_named_as_in_the_paper() -> None:
    assert [title_of(name) for name in ("fig3b", "fig10", "table1", "table5")] == [
        *("Fig. 3b", "Fig. 10", "Table I", "Table V"),
    ]


def test_the_committed_page_is_generated_from_records_of_a_whole_run() -> None:
    files = sorted(runner.RECORDS.glob("*.json"))
    assert runner.PAGE.is_file() == bool(files), "run tools/reproduce"
    if files:
        stored = [read_record(runner.RECORDS / f"{name}.json") for name in PAPER_ORDER]
        assert page_text(stored, "../figures/reproduction") == runner.PAGE.read_text(encoding="utf-8")
        assert not any(one.origin.is_quick for one in stored)
        assert all((runner.FIGURES / name).is_file() for one in stored for name in one.record.figures)


def test_a_page_is_not_written_while_records_are_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in runner.NAMES[1:]:
        write_record(tmp_path, record(name), ORIGIN)
    assert runner.main(["--page", "--out", str(tmp_path)]) == 0
    assert runner.NAMES[0] in capsys.readouterr().err and not (tmp_path / "reproduction.md").exists()
    write_record(tmp_path, record(runner.NAMES[0]), ORIGIN)
    assert runner.main(["--page", "--out", str(tmp_path)]) == 0
    assert (tmp_path / "reproduction.md").read_text(encoding="utf-8").startswith("# The paper's figures")


@given(pieces=st.lists(st.text("ab\n ", max_size=5), max_size=8))
def test_lines_are_relayed_whole_however_they_are_written(pieces: list[str]) -> None:
    lines: list[str] = []
    relay = LineRelay(lines.append)
    for piece in [*pieces, "\n"]:
        assert relay.write(piece) == len(piece)
    assert lines == [line.strip() for line in "".join(pieces).split("\n") if line.strip()]
