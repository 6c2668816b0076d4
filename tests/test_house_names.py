"""House rules for names, structure and references; `tools/measure house` prints the same counts."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.house import ROOT, package_files, place, text_files
from tools.house import documents, names, structure

# Contracts of parts: each file of a family exports these under the same name.
CONTRACT_CLASSES: frozenset[str] = frozenset()
MAX_STOP_WORD_PERCENT = 1.5
# A small file may bind one stop word, where one is more than MAX_STOP_WORD_PERCENT of its names.
FREE_STOP_WORDS = 1
CROWDED = ("effects",)  # a part is a file: the folder is the catalogue
COUNTER_ITSELF = ("tools/house/documents.py", "tests/test_house_names.py")  # hold the patterns that are looked for
# Their bytes are hashed in the cards of the shipped models, so that a comment cannot change without new models.
HASHED = ("dbc/", "bench_configs/models/")
# One tick of a kernel each, in the order of its equations, and two builders of one large record.
LONG = {
    "batch/episode.py": "drive",
    "control/follower.py": "step",
    "plant/actuation/bywire.py": "step_bywire",
    "plant/data_sheet.py": "constants_of",
    "plant/reference.py": "step_reference",
    "plant/reference_vehicle/car.py": "constants_of",
}


def sources() -> dict[str, str]:
    """Place in the package -> source text."""
    return {place(path): path.read_text(encoding="utf-8") for path in package_files()}


def denied_modules(paths: list[str]) -> list[str]:
    """Modules and folders whose name is on the deny-list."""
    return [path for path in paths if set(Path(path).with_suffix("").parts) & names.DENIED_MODULES]


def stop_words_over_budget(source: str) -> tuple[tuple[int, str], ...]:
    """The stop words of a file that has more of them than the budget allows; empty where it keeps to it."""
    count = names.count_bindings(source)
    if len(count.stop_words) <= FREE_STOP_WORDS or count.share_percent <= MAX_STOP_WORD_PERCENT:
        return ()
    return count.stop_words


def test_no_module_has_a_denied_name() -> None:
    assert denied_modules([place(path) for path in package_files()]) == []


def test_every_file_keeps_to_its_stop_word_budget() -> None:
    over = {inside: stop_words_over_budget(source) for inside, source in sources().items()}
    assert not {inside: words for inside, words in over.items() if words}


def test_the_package_keeps_to_the_stop_word_budget() -> None:
    whole = names.total(names.count_bindings(source) for source in sources().values())
    assert whole.share_percent <= MAX_STOP_WORD_PERCENT


def test_class_names_are_unique() -> None:
    duplicates = names.duplicate_classes(package_files())
    assert {
        name: [place(path) for path in paths] for name, paths in duplicates.items() if name not in CONTRACT_CLASSES
    } == {}


def test_no_decision_reads_a_sentence() -> None:
    found = {inside: structure.sentence_decisions(source) for inside, source in sources().items()}
    assert not {inside: places for inside, places in found.items() if places}


def test_no_function_returns_three_bare_values() -> None:
    found = {inside: structure.bare_tuples(source) for inside, source in sources().items()}
    assert not {inside: places for inside, places in found.items() if places}


def test_no_function_is_too_long() -> None:
    found = {
        inside: [place for place in structure.long_functions(source) if place.name != LONG.get(inside)]
        for inside, source in sources().items()
    }
    assert not {inside: places for inside, places in found.items() if places}


def test_no_folder_is_crowded() -> None:
    folders = {folder.name: count for folder, count in structure.crowded_folders(package_files()).items()}
    assert not {name: count for name, count in folders.items() if name not in CROWDED}


def test_no_text_refers_to_an_absent_document() -> None:
    found = {}
    for path in text_files():
        inside = path.relative_to(ROOT).as_posix()
        if inside not in COUNTER_ITSELF and not inside.startswith(HASHED):
            found[inside] = documents.absent_references(path.read_text(encoding="utf-8"))
    assert not {inside: references for inside, references in found.items() if references}


def test_readme_and_docs_are_short() -> None:
    pages = [path for path in (ROOT / "docs").rglob("*.md") if "results" not in path.parts]
    assert documents.count_words([ROOT / "README.md"]) <= 900
    assert documents.count_words(pages) <= 19_800  # 18,000, and 1,800 for MPC, weights, export, sweeps, samplers


@pytest.mark.parametrize("path", ["gap/told.py", "gap/taken_back.py", "tune/shelf/trials.py"])
def test_a_planted_module_name_is_found(path: str) -> None:
    assert denied_modules([path]) and not denied_modules(["gap/selection/verdict.py"])


def test_planted_stop_words_are_found() -> None:
    source = "def f(found):\n    said = [one for one in found]\n    for one in said:\n        there = one\n"
    assert [word for _, word in names.count_bindings(source).stop_words] == ["found", "said", "one", "there"]
    assert stop_words_over_budget(source) and not stop_words_over_budget("def f(found):\n    return found\n")


def test_a_planted_duplicate_class_is_found(tmp_path: Path) -> None:
    paths = [tmp_path / "a.py", tmp_path / "b.py"]
    for path in paths:
        path.write_text("class Plan:\n    pass\n")
    assert names.duplicate_classes(paths) == {"Plan": paths}


@pytest.mark.parametrize(
    ("source", "count"),
    [
        ('if words[0].endswith("as usual with this model"): pass', 1),
        ('x = "not real time" in text', 1),
        ('x = text == "none found"', 1),
        ('x = kind == "none_missing"', 0),
        ('x = text.startswith("# ")', 0),
    ],
)
def test_planted_decisions_on_sentences_are_found(source: str, count: int) -> None:
    assert len(structure.sentence_decisions(source)) == count


@pytest.mark.parametrize(
    ("source", "count"),
    [
        ("def f() -> tuple[int, str, float]: ...", 1),
        ("def f() -> Generator[str, None, tuple[int, int, int]]: ...", 1),
        ("def f() -> tuple[int, ...]: ...", 0),
        ("def f() -> tuple[int, str]: ...", 0),
    ],
)
def test_planted_bare_tuples_are_found(source: str, count: int) -> None:
    assert len(structure.bare_tuples(source)) == count


def test_planted_long_functions_and_crowded_folders_are_found() -> None:
    body = "    x = 1\n" * structure.MAX_FUNCTION_LINES
    assert structure.long_functions("def f():\n" + body) and not structure.long_functions("def f():\n    x = 1\n")
    files = [Path("a") / f"m{i}.py" for i in range(structure.MAX_FOLDER_FILES + 1)]
    assert structure.crowded_folders(files) and not structure.crowded_folders(files[1:])


@pytest.mark.parametrize("text", ["(interfaces" + " 2)", "design" + " D5", "apollo" + "_facts 1.2"])
def test_planted_absent_references_are_found(text: str) -> None:
    assert documents.absent_references(text)
