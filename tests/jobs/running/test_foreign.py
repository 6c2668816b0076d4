"""Somebody else's controller: which program, which of its parameters, and what is said when it does not do its part."""

from __future__ import annotations

import json
import os
import shlex
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.command import Ended, eventually, new_session, no_orphans, one_message, tunefree
from tests.jobs.foreign_node import AT
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load, own_parameters, parameters_of
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.jobs.identity import compute_identity, resolved_toml
from tunefree_hil.jobs.running.foreign import (
    controller_program,
    program_hashes,
    require_announced,
    require_foreign_controller,
    with_controller_command,
)
from tunefree_hil.jobs.running.session_parts import CommandPlaceholders, write_reference_paths

NODE = Path(__file__).parents[1] / "foreign_node.py"
OWN = """[controller]
command = ["./mine", "{bus}", "{paths}"]
[controller.parameters]
"mine.gain" = 0.5
"""
BOXES = {"mine.gain": "low = 0.1, high = 2.0", "mine.lag_s": "low = 0.1, high = 0.4"}


def bench_file(folder: Path, more: str = OWN, names: Iterable[str] = BOXES) -> Path:
    """A bench file that searches parameters of a controller that is not ours."""
    path = write_bench(folder, more=more)
    searched = ", ".join(f'{{ name = "{name}", {BOXES[name]} }}' for name in names)
    path.write_text(path.read_text().replace('set = "mrac"', f"parameters = [{searched}]"))
    return path


def lanes(announced: dict[int, str]) -> Any:
    """What `require_announced` asks of the benches."""
    return [SimpleNamespace(runner=SimpleNamespace(announced=lambda: announced))]


def test_its_parameters_are_the_bench_files_values_or_the_middle_of_their_boxes(tmp_path: Path) -> None:
    bench = load(bench_file(tmp_path))
    assert own_parameters(bench) == {"mine.gain": 0.5, "mine.lag_s": pytest.approx(0.2)}
    values = parameters_of(bench)
    assert values["mine.gain"] == 0.5 and values["lqr.q1"] > 0.0, "the controller may use ours as well"


def test_a_program_beside_the_bench_file_is_found_from_anywhere(tmp_path: Path) -> None:
    bench = load(bench_file(tmp_path))
    assert controller_program(bench) == ["./mine", "{bus}", "{paths}"], "it is not there yet: as written"
    (tmp_path / "mine").write_text("first")
    assert controller_program(bench) == [str(tmp_path / "mine"), "{bus}", "{paths}"]
    assert str(tmp_path / "mine") in resolved_toml(bench), "the run folder's copy finds it too"
    assert controller_program(load(write_bench(tmp_path / "ours"))) is None


def test_a_program_that_was_built_anew_makes_another_run(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("first")
    bench = load(bench_file(tmp_path))
    first = compute_identity(bench, "mkz_nominal", bench.scenarios.values())
    assert list(first["hashes"]["controller"]) == ["mine"]
    (tmp_path / "mine").write_text("second")
    second = compute_identity(bench, "mkz_nominal", bench.scenarios.values())
    assert first["identity"] != second["identity"]
    assert program_hashes(load(write_bench(tmp_path / "ours"))) == {}


def test_an_environments_python_keeps_its_name(tmp_path: Path) -> None:
    """Its link followed, it would be the machine's, without the environment's packages."""
    (tmp_path / "python").symlink_to(sys.executable)
    bench = load(bench_file(tmp_path, OWN.replace("./mine", "./python")))
    assert (controller_program(bench) or [""])[0] == str(tmp_path / "python")


def test_the_words_of_the_option_are_the_shells(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "mine").write_text("")
    monkeypatch.chdir(tmp_path / "elsewhere")
    bench = load(bench_file(tmp_path))
    asked = with_controller_command(bench, "./mine {bus} 'two words'")
    assert controller_program(asked) == [str(tmp_path / "elsewhere" / "mine"), "{bus}", "two words"]
    assert controller_program(with_controller_command(bench, "")) == controller_program(bench)
    with pytest.raises(InputError, match="No closing quotation"):
        with_controller_command(bench, "./mine 'open")


def test_reference_drives_are_written_where_the_command_asks_for_them(tmp_path: Path) -> None:
    bench = load(write_bench(tmp_path, duration_s=1.0))
    assert write_reference_paths(["./mine", "{bus}"], bench, tmp_path / "p") == "" and not (tmp_path / "p").exists()
    folder = write_reference_paths(["./mine", "--paths={paths}"], bench, tmp_path / "p")
    (written,) = Path(folder).iterdir()
    assert written.stem == bench.scenarios["tiny"].hash[:12]
    rows = written.read_text().splitlines()
    assert rows[0].startswith("t_s,x_m,y_m,heading_rad,speed_mps") and len(rows) > 100
    assert CommandPlaceholders("v", "b", "c", "t", "s", "0", folder).fill(["--paths={paths}"]) == [f"--paths={folder}"]


def test_without_any_such_controller_its_parameters_are_refused(tmp_path: Path) -> None:
    bench = load(bench_file(tmp_path, more=""))
    with pytest.raises(InputError, match=r"the built-in controller has no parameter mine\.gain") as caught:
        require_foreign_controller(bench, ["lqr.q1", "mine.gain"], join=False)
    assert "--controller" in caught.value.hint and "--join" in caught.value.hint
    require_foreign_controller(bench, ["mine.gain"], join=True)
    require_foreign_controller(bench, ["lqr.q1"], join=False)


@pytest.mark.parametrize(
    ("announced", "hint"),
    [({}, "HELLO (id 0x6E6, role 2)"), ({16: "mine.gian", 17: "mine.lag_s"}, "mine.gian, mine.lag_s")],
)
def test_a_parameter_that_was_not_announced_is_refused(tmp_path: Path, announced: dict[int, str], hint: str) -> None:
    bench = load(bench_file(tmp_path))
    with pytest.raises(InputError, match=r"did not announce the parameter mine\.gain") as caught:
        require_announced(bench, lanes(announced), ["lqr.q1", "mine.gain"])
    assert hint in caught.value.hint and caught.value.key == "tune.parameters"
    require_announced(bench, lanes({16: "mine.gain"}), ["lqr.q1", "mine.gain"])


@contextmanager
def nothing_left(session: str) -> Iterator[None]:
    """No process of the bench, and none of the foreign controller, lives on."""

    def alive() -> list[str]:
        texts = []
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            try:
                texts.append(path.read_bytes().decode(errors="replace"))
            except OSError:  # it ended while we looked
                continue
        return [text for text in texts if NODE.name in text and session in text]

    with no_orphans(session):
        yield
        eventually(lambda: not alive(), 8.0, "the end of the foreign controller")


def driven(command: str, mode: str, folder: Path, *names: str) -> Ended:
    """`drive` or `tune` with the faulty controller; the session is in its command line, to be found by."""
    session = new_session()
    words = shlex.join([sys.executable, str(NODE), mode, "{session}"])
    more = ("--no-verify",) if command == "tune" else ()
    with nothing_left(session):
        return tunefree(
            *(command, bench_file(folder, "", names), "--controller", words, "--session", session, *more),
            *("--bus", "tfhub", "--out", folder / "runs", "--json"),
        )


@pytest.fixture
def _importable(monkeypatch: pytest.MonkeyPatch) -> None:
    """The faulty controller imports the package, from wherever it is started."""
    root = str(NODE.parents[2])
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH", "")])))


@pytest.mark.slow
@pytest.mark.usefixtures("_importable")
class TestRealProcesses:
    def test_one_that_announces_nothing_is_told_what_to_send(self, tmp_path: Path) -> None:
        done = driven("tune", "nameless", tmp_path, *BOXES)
        assert done.status == 2
        one_message(
            done, "did not announce the parameter mine.gain, mine.lag_s", "INDEX NAME", "docs/how-to/own_controller.md"
        )
        assert [error["code"] for error in done.errors] == ["not_announced"]
        assert not list(tmp_path.glob("runs/*/episodes/*")), "before anything is driven"

    def test_one_that_answers_late_is_named_at_the_hard_limit(self, tmp_path: Path) -> None:
        done = driven("drive", "late", tmp_path, "mine.gain")
        assert done.status == 3
        assert f"tick {AT}: the controller did not answer within 5 s" in done.words
        assert "Traceback" not in done.words and len(done.errors) == 1

    @pytest.mark.parametrize(
        ("mode", "words"),
        [
            ("crash", ["controller process ended with status 5", "the gain table is empty", "controller.txt"]),
            ("leaves", ["controller process ended with status 0", "enough for today", "controller.txt"]),
        ],
    )
    def test_one_that_ends_in_the_middle_is_named(self, tmp_path: Path, mode: str, words: list[str]) -> None:
        done = driven("drive", mode, tmp_path, "mine.gain")
        assert done.status == 3
        one_message(done, *words)
        assert done.errors[0]["hint"]

    @pytest.mark.parametrize("number", [1000, 4711])
    def test_one_that_fails_by_an_error_of_its_own_has_failed_the_drive(self, tmp_path: Path, number: int) -> None:
        """Design D11: the parameters answer for it with the worst score, the bench does not."""
        done = driven("drive", str(number), tmp_path, "mine.gain")
        assert done.status == 0, done.words
        assert done.data["score"] == 10.0 and bc.error_text(number) in done.words
        (kept,) = tmp_path.glob("runs/*/episodes/0/episode.json")
        episode = json.loads(kept.read_text())
        assert (episode["error"], episode["error_code"], episode["ticks"]) == ("controller_own", number, AT + 1)
