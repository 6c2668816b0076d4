"""Names and paths become files; a miss lists what there is."""

from __future__ import annotations

from pathlib import Path

import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.find import KINDS, available, find

SCENARIO = "left_turn"


def test_a_name_is_found_in_the_checkout_from_anywhere(
    repo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert find("vehicle", "mkz_bywire") == repo / "dbc" / "mkz_bywire" / "vehicle.toml"
    assert find("scenario", SCENARIO) == repo / "bench_configs" / "scenarios" / f"{SCENARIO}.toml"
    assert find("weights", "default.toml") == repo / "bench_configs" / "weights" / "default.toml"
    assert find("model", "mkz_nominal") == repo / "bench_configs" / "models" / "mkz_nominal" / "model.toml"


def test_a_path_is_a_folder_or_the_file_in_it(repo: Path) -> None:
    folder = repo / "dbc" / "mkz_bywire"
    assert find("vehicle", folder) == find("vehicle", folder / "vehicle.toml") == find("vehicle", str(folder))


def test_what_is_beside_the_bench_file_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    bench = tmp_path / "mine" / "bench.toml"
    for path in (bench, tmp_path / "mine" / f"{SCENARIO}.toml", tmp_path / f"{SCENARIO}.toml"):
        path.parent.mkdir(exist_ok=True)
        path.write_text("")
    assert find("scenario", SCENARIO, near=bench) == tmp_path / "mine" / f"{SCENARIO}.toml"
    assert find("scenario", SCENARIO, near=bench.parent) == tmp_path / "mine" / f"{SCENARIO}.toml"
    assert find("scenario", SCENARIO) == tmp_path / f"{SCENARIO}.toml"


def test_the_folders_of_a_project_of_ones_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "dbc" / "truck").mkdir(parents=True)
    (tmp_path / "dbc" / "truck" / "vehicle.toml").write_text("")
    assert find("vehicle", "truck") == tmp_path / "dbc" / "truck" / "vehicle.toml"
    assert {"truck", "mkz_bywire", "rav4_2017"} <= set(available("vehicle"))


@pytest.mark.parametrize("kind", KINDS)
def test_a_miss_lists_what_there_is(kind: str) -> None:
    with pytest.raises(InputError) as caught:
        find(kind, "no_such_thing")
    assert caught.value.code == f"unknown_{kind}" and caught.value.exit_status == 2
    for name in available(kind):
        assert name in str(caught.value)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["/", "", ".", "..", "~nouser/x", "~nouser", "a\0b", "a" * 5000, "/a" * 3000])
def test_a_name_that_no_file_can_have_is_a_miss(kind: str, name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        find(kind, name, near=tmp_path)
    assert caught.value.code == f"unknown_{kind}" and repr(name) in caught.value.message


def test_the_home_folder_is_meant_by_a_tilde(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "mine.toml").write_text("")
    assert find("scenario", "~/mine") == tmp_path / "mine.toml"


def test_a_slip_is_guessed() -> None:
    with pytest.raises(InputError, match="there is no vehicle 'mkz_bywyre'") as caught:
        find("vehicle", "mkz_bywyre")
    assert "did you mean mkz_bywire?" in caught.value.hint
