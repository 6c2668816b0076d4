"""`weights` with files of pairs: the file that it writes is used by a bench, and bad pairs give one message."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.grade.weight_regression.made_pairs import METRICS
from tests.house import ROOT
from tests.jobs.weights.graded_runs import graded_run, pairs_file, write_pairs
from tunefree_hil.base.events import Event
from tunefree_hil.bench import load
from tunefree_hil.cli.entry import run
from tunefree_hil.config.load import load_weights
from tunefree_hil.jobs.weights.options import WeightsOptions
from tunefree_hil.jobs.weights.weights import weights

RULE = (0.0, 0.0, 5.0, 1.0)  # a person who steers and pedals gently, whatever the errors


def regress(pairs: Path, out: Path, **changes: object) -> list[Event]:
    return list(weights(WeightsOptions(out=out, pairs=pairs)._replace(**changes)))


@pytest.fixture
def message(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs a command line that must end with status 2; its one error message."""

    def run_refused(*words: object) -> str:
        assert run(["weights", *map(str, words), "--plain"]) == 2
        text = capsys.readouterr().err
        assert text.count("error:") == 1 and "Traceback" not in text
        return text[text.index("error:") :]

    return run_refused


@pytest.mark.slow
def test_weights_of_a_file_of_pairs_are_used_by_a_bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "weights").mkdir()
    events = regress(write_pairs(tmp_path / "runs", RULE, 12), Path("weights/my.toml"))
    result = events[-1]
    assert result.kind == "result" and Path(result.data["weights"]).is_file()
    assert sum(event.kind == "progress" for event in events) == 22
    spec, base = load_weights("my"), load_weights("default")
    assert sum(spec.metrics.values()) == pytest.approx(sum(base.metrics.values()), rel=1e-3)
    assert (spec.against, spec.largest_value, spec.replan_penalty) == ("original", 3.0, 1.0)
    tracking, gentle = METRICS[:2], METRICS[2]
    assert all(spec.metrics[name] < base.metrics[name] for name in tracking)
    assert spec.metrics[gentle] > 1.1 * base.metrics[gentle]
    bench = tmp_path / "bench.toml"
    bench.write_text((ROOT / "bench_configs" / "mkz_steer.toml").read_text().replace('"default"', '"my"'))
    assert load(bench).weights.metrics == spec.metrics


@pytest.mark.slow
def test_the_file_and_the_report_say_where_the_weights_come_from(tmp_path: Path) -> None:
    out = tmp_path / "my.toml"
    regress(write_pairs(tmp_path / "runs", RULE, 12), out, seed=5)
    head, report = out.read_text(), json.loads((tmp_path / "my" / "report.json").read_text())
    for text in (f"pairs_sha256 = {report['pairs_sha256']}", "seed = 5", "margin = 0.05", "held_out_accuracy"):
        assert text in head
    assert report["n_pairs"] == len(report["pairs"]) == 36
    assert all(len(row["sha256"]) == 64 for row in report["pairs"])
    assert report["accuracies"]["human"]["regressed"]["n"] == 36
    assert "paper" not in report["accuracies"]["all"]  # a graded log has the metrics of its own weights only
    assert (tmp_path / "my" / "weights.png").stat().st_size > 10_000
    assert tomllib.loads(head)["name"] == "my"


@pytest.mark.slow
def test_the_same_pairs_give_the_same_file(tmp_path: Path) -> None:
    pairs = write_pairs(tmp_path / "runs", RULE, 8)
    texts = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        regress(pairs, tmp_path / name / "my.toml")
        texts.append((tmp_path / name / "my.toml").read_text())
    assert texts[0] == texts[1]


@pytest.mark.slow
def test_a_pair_and_its_reverse_are_named_and_nothing_is_written(tmp_path: Path, message: Callable[..., str]) -> None:
    pairs = write_pairs(tmp_path / "runs", RULE, 12)
    entries = tomllib.loads(pairs.read_text())["pairs"]
    first = entries[0]
    entries.append({"human": first["generated"][0], "generated": [first["human"]], "group": first["group"]})
    pairs_file(pairs, entries)
    text = message(pairs, "--out", tmp_path / "my.toml")
    assert "pairs contradict each other" in text and "both ways round" in text
    assert Path(first["human"]).name in text and "--force" in text
    assert not (tmp_path / "my.toml").exists()
    assert run(["weights", str(pairs), "--out", str(tmp_path / "my.toml"), "--force", "--plain"]) == 0
    assert "contradicting_pairs" in (tmp_path / "my.toml").read_text()


@pytest.mark.slow
def test_pairs_without_a_rule_are_refused_with_the_worst_named(tmp_path: Path, message: Callable[..., str]) -> None:
    """Half of the groups say the opposite of the other half."""
    pairs = write_pairs(tmp_path / "runs", RULE, 12)
    entries = tomllib.loads(pairs.read_text())["pairs"]
    for number, entry in enumerate(entries):
        if number % 2:
            entry["human"], entry["generated"] = entry["generated"][0], [entry["human"]]
    text = message(pairs_file(pairs, entries), "--out", tmp_path / "my.toml")
    assert "not ranked better than by chance" in text and " lacks 0." in text
    assert not (tmp_path / "my.toml").exists()


@pytest.mark.slow
def test_fewer_pairs_than_weights_are_refused(tmp_path: Path, message: Callable[..., str]) -> None:
    text = message(write_pairs(tmp_path / "runs", RULE, 4, n_each=2), "--out", tmp_path / "my.toml")
    assert "fewer pairs than weights" in text and "8 pairs for 13 weights" in text


@pytest.mark.slow
def test_too_few_groups_are_refused(tmp_path: Path, message: Callable[..., str]) -> None:
    text = message(write_pairs(tmp_path / "runs", RULE, 2, n_each=10), "--out", tmp_path / "my.toml")
    assert "in 2 groups; 3 groups are needed" in text


@pytest.mark.parametrize("changes", [{"scenario": "other"}, {"scenario_hash": "cd" * 32}])
def test_unlike_tasks_are_refused(tmp_path: Path, message: Callable[..., str], changes: dict[str, str]) -> None:
    human = graded_run(tmp_path / "runs", "anna", [0.1, 0.1, 0.1, 0.1])
    gains = graded_run(tmp_path / "runs", "gains", [0.2, 0.2, 0.2, 0.2], **changes)
    pairs = pairs_file(tmp_path / "pairs.toml", [{"human": human, "generated": [gains]}])
    text = message(pairs, "--out", tmp_path / "my.toml")
    assert "key pairs[0]" in text and "pair drives of the same scenario" in text


def test_drives_without_any_metric_are_refused(tmp_path: Path, message: Callable[..., str]) -> None:
    entries = []
    for number in range(3):
        runs = [graded_run(tmp_path / "runs", f"{side}{number}", [None] * 4, scenario=f"road{number}") for side in "ab"]
        entries.append({"human": runs[0], "generated": [runs[1]]})
    text = message(pairs_file(tmp_path / "pairs.toml", entries), "--out", tmp_path / "my.toml")
    assert "no weighted metric is available in both drives" in text


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["--out", "my.toml"], ["there are no pairs", "--bench"]),
        (["pairs.toml", "--out", "my.json"], ["does not end in .toml"]),
        (["none.toml", "--out", "my.toml"], ["none.toml", "no such file"]),
        (["pairs.toml", "--out", "my.toml", "--margin", "0"], ["--margin 0 is not above 0"]),
        (["pairs.toml", "--out", "taken.toml"], ["taken.toml", "not regressed"]),
        (["empty.toml", "--out", "my.toml"], ["empty.toml", "key pairs", "has no pair"]),
        (["wrong.toml", "--out", "my.toml"], ["wrong.toml", "key pairs[0].humans", "did you mean human"]),
    ],
)
def test_bad_options_give_one_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, message: Callable[..., str], words: list[str], parts: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    pairs_file(Path("pairs.toml"), [{"human": "a", "generated": ["b"]}])
    pairs_file(Path("empty.toml"), [])
    pairs_file(Path("wrong.toml"), [{"humans": "a", "generated": ["b"]}])
    Path("taken.toml").write_text((ROOT / "bench_configs" / "weights" / "default.toml").read_text())
    text = message(*words)
    assert all(part in text for part in parts), text
