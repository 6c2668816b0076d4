"""The command: which values are taken, what is refused, and that a folder is there whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.command import one_message, tunefree
from tests.jobs.export.made_values import PREVIEW
from tests.jobs.export.read_back import read_text_proto
from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import load, parameters_of
from tunefree_hil.config.dump import to_toml
from tunefree_hil.jobs.export.export import PAGE, TARGETS, export, write_folder
from tunefree_hil.jobs.export.remarks import ExportFile
from tunefree_hil.jobs.export.values import collect_values
from tunefree_hil.jobs.identity import resolved_toml
from tunefree_hil.jobs.options.records import ExportOptions
from tunefree_hil.jobs.run_folder import RunFolder


def make_run(root: Path, verdict: str = "ACCEPTED", command: str = "tune") -> Path:
    """A tune that found q1 = 0.0625, of the tiny bench."""
    bench = load(write_bench(root))
    run = RunFolder.create(root, "tune-b", {"command": command, "model": bench.spec.model})
    (run.path / "bench.toml").write_text(resolved_toml(bench))
    table = "rejected_parameters" if verdict == "REJECTED" else "parameters"
    best = {"verdict": verdict, table: parameters_of(bench, {"lqr.q1": 0.0625})}
    (run.path / "best.toml").write_text(to_toml(best))
    return run.path


def run_export(source: Path, target: str, out: Path, set_name: str | None = None) -> list[Event]:
    return list(export(ExportOptions(source, target, out, set_name)))


def first_weight(out: Path) -> float:
    text = (out / "apollo_6_7" / "control_conf.pb.txt").read_text()
    return read_text_proto(text)["lat_controller_conf"][0]["matrix_q"][0]


@pytest.mark.slow
def test_the_winner_a_manual_set_and_a_bench_files_own_values(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    events = run_export(run, "apollo", tmp_path / "a")
    assert first_weight(tmp_path / "a") == 0.0625
    assert events[-1].data["verdict"] == "ACCEPTED" and "exported tuned of" in events[-1].data["sentence"]
    assert not any("not verified" in event.message for event in events)
    run_export(run, "apollo", tmp_path / "b", "as_shipped")
    assert first_weight(tmp_path / "b") == 0.05
    chosen = write_bench(tmp_path / "own", more='[controller.parameters]\n"lqr.q1" = 0.125\n')
    run_export(chosen, "apollo", tmp_path / "c")
    assert first_weight(tmp_path / "c") == 0.125
    run_export(chosen, "apollo", tmp_path / "d", "mrac_on")
    assert first_weight(tmp_path / "d") == 0.05


def test_a_rejected_winner_is_exported_by_name_only_and_an_unverified_one_with_a_warning(tmp_path: Path) -> None:
    run = make_run(tmp_path, "REJECTED")
    with pytest.raises(InputError, match="REJECTED") as refused:
        run_export(run, "apollo", tmp_path / "a")
    assert refused.value.code == "rejected" and "--set tuned" in refused.value.hint
    assert not (tmp_path / "a").exists()
    run_export(run, "apollo", tmp_path / "b", "tuned")
    assert first_weight(tmp_path / "b") == 0.0625
    events = run_export(make_run(tmp_path / "new", "not verified"), "apollo", tmp_path / "c")
    assert any(event.kind == "warning" and "not verified" in event.message for event in events)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("more", ["", PREVIEW])
def test_every_parameter_is_in_a_file_or_on_the_page(target: str, more: str, tmp_path: Path) -> None:
    path = write_bench(tmp_path, more=more)
    source = collect_values(path, None)
    made = TARGETS[target](source)
    events = run_export(path, target, tmp_path / "out")
    page = (tmp_path / "out" / PAGE).read_text()
    assert len(source.values) >= 16
    for name in source.values:
        assert name in made.exported or f"**{name}**" in page, name
    assert not made.exported - set(source.values)
    assert {event.message.partition(":")[0] for event in events if event.kind == "warning"} == {
        subject for subject in events[-1].data["differs"]
    }
    assert sorted(events[-1].data["files"]) == sorted(
        str(one) for one in (tmp_path / "out").rglob("*") if one.is_file()
    )


def test_mistakes_are_one_message_each(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    with pytest.raises(InputError, match="no set 'best'") as refused:
        run_export(run, "apollo", tmp_path / "a", "best")
    assert "tuned, as_shipped, mrac_on" in refused.value.hint
    with pytest.raises(InputError, match="no winner"):
        run_export(make_run(tmp_path / "driven", command="drive"), "apollo", tmp_path / "a")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="not empty"):
        run_export(run, "apollo", tmp_path / "full")
    own = write_bench(tmp_path / "own", more='[controller]\ncommand = ["./mine"]\n')
    with pytest.raises(InputError, match="controller of its own"):
        run_export(own, "autoware", tmp_path / "a")
    assert (tmp_path / "full" / "mine.txt").read_text() == "mine" and not (tmp_path / "a").exists()


def test_what_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    files = [ExportFile("a/b.txt", "one"), ExportFile("a/b.txt/c.txt", "a file is no folder")]
    with pytest.raises(BenchError, match="cannot write"):
        write_folder(tmp_path / "out", files)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "out").mkdir()
    write_folder(tmp_path / "out", files[:1])
    assert (tmp_path / "out" / "a" / "b.txt").read_text() == "one" and len(list(tmp_path.iterdir())) == 1


@pytest.mark.slow
def test_as_a_person_calls_it(tmp_path: Path) -> None:
    bench = write_bench(tmp_path)
    ended = tunefree("export", bench, "--to", "autoware", "--out", tmp_path / "out", "--json")
    assert ended.status == 0, ended.words
    assert "warning: pedals" in ended.words and ended.data["target"] == "autoware"
    assert json.dumps(ended.data["not_exported"])
    assert {"accel_map.csv", "brake_map.csv", PAGE} <= {one.name for one in (tmp_path / "out").iterdir()}
    again = tunefree("export", bench, "--to", "autoware", "--out", tmp_path / "out")
    assert again.status == 2
    one_message(again, "not empty", "--out")
