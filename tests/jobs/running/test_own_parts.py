"""A controller part in Python, over the bus: driven, tuned, told from another version of itself."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.bench.own_part import PART, write_own
from tests.jobs.command import Ended, tunefree, tunefree_alone
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load, part_names
from tunefree_hil.jobs.identity import compute_identity, resolved_toml
from tunefree_hil.jobs.running.foreign import require_foreign_controller

TUNED = 'parameters = [{ name = "mine.gain", low = 0.5, high = 4.0 }]'


def test_a_part_that_was_changed_makes_another_run(tmp_path: Path) -> None:
    bench = load(write_own(tmp_path))
    first = compute_identity(bench, "mkz_nominal", bench.scenarios.values())
    assert list(first["hashes"]["parts"]) == ["mine.py"]
    (tmp_path / "mine.py").write_text(PART.replace("2.0 * tracking", "1.0 * tracking"))
    assert compute_identity(bench, "mkz_nominal", bench.scenarios.values())["identity"] != first["identity"]


def test_the_run_folders_copy_names_its_file(tmp_path: Path) -> None:
    bench = load(write_own(tmp_path))
    copy = tmp_path / "run" / "bench.toml"
    copy.parent.mkdir()
    copy.write_text(resolved_toml(bench))
    assert part_names(load(copy)) == part_names(bench) and part_names(bench).lateral.startswith(str(tmp_path))


def test_what_is_searched_must_be_a_parts(tmp_path: Path) -> None:
    bench = load(write_own(tmp_path))
    require_foreign_controller(bench, ["lqr.q1", "mine.gain"], join=False)
    with pytest.raises(InputError, match=r"no parameter mine\.gian"):
        require_foreign_controller(bench, ["mine.gian"], join=False)


def driven(folder: Path, *more: str) -> Ended:
    """`drive` of the bench in `folder`."""
    return tunefree_alone("drive", folder / "b.toml", *more, "--bus", "tfhub", "--out", folder / "runs", "--json")


@pytest.mark.slow
class TestRealProcesses:
    def test_its_parameter_arrives_over_the_bus(self, tmp_path: Path) -> None:
        write_own(tmp_path, 'parameters = { "mine.gain" = 0.75 }', duration_s=1.0)
        first = driven(tmp_path)
        assert first.status == 0, first.words
        (kept,) = Path(first.data["run"]).glob("episodes/0/episode.json")
        assert json.loads(kept.read_text())["parameters"]["mine.gain"] == 0.75
        other = driven(tmp_path, "--parameter", "mine.gain=3")
        assert other.status == 0 and other.data["hashes"] != first.data["hashes"]
        again = tunefree("replay", first.data["run"], "--verify", "--json")
        assert again.status == 0, again.words

    def test_it_is_tuned(self, tmp_path: Path) -> None:
        path = write_own(tmp_path, duration_s=1.0)
        path.write_text(path.read_text().replace('set = "mrac"', TUNED))
        done = tunefree_alone(
            *("tune", path, "--trials", "2", "--no-verify", "--benches", "1", "--bus", "tfhub"),
            *("--out", tmp_path / "runs", "--json"),
        )
        assert done.status == 0, done.words
        (best,) = tmp_path.glob("runs/*/best.toml")
        assert '"mine.gain"' in best.read_text()
