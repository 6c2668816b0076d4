"""The list of samplers: everything that names them agrees with it, and what is missing is said before a run."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

from tests.bench.tiny import write_bench
from tests.tune.drive_study import settings
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import TuneSpec
from tunefree_hil.jobs.options.records import TuneOptions
from tunefree_hil.jobs.tune.options import make_tune_plan
from tunefree_hil.tune.sampling import AUTO, KAPPA_W, RECORDS, SAMPLERS, check_sampler, records
from tunefree_hil.tune.store import check_settings, describe_differences

PAGE = Path(__file__).resolve().parents[3] / "docs" / "reference" / "samplers.md"


def test_the_bench_file_and_the_command_know_every_sampler() -> None:
    assert get_args(get_type_hints(TuneSpec)["sampler"]) == (AUTO, *SAMPLERS)
    (help_text,) = [entry.help for entry in get_type_hints(TuneOptions, include_extras=True)["sampler"].__metadata__]
    assert all(re.search(rf"\b{name}\b", help_text) for name in (AUTO, *SAMPLERS))
    assert TuneSpec().kappa_w == KAPPA_W


def test_the_options_of_the_paper_are_there() -> None:
    """Table III: three acquisitions of GPR, one of TPE; independent and relative sampling."""
    pairs = {(record.surrogate, record.acquisition) for record in RECORDS}
    assert {("GPR", "UCB"), ("GPR", "EI"), ("GPR", "ME"), ("TPE", "EI")} <= pairs
    assert {record.drawing for record in RECORDS if record.surrogate == "TPE"} == {"independent", "relative"}


def test_the_page_is_the_table() -> None:
    rows = [
        [cell.strip().strip("`") for cell in line.strip("|\n").split("|")]
        for line in PAGE.read_text(encoding="utf-8").splitlines()
        if line.startswith("|`")
    ]
    yes = {True: "yes", False: "no"}
    assert rows == [
        [
            record.name, record.surrogate, record.acquisition, record.drawing, record.constraints,
            yes[record.objectives], record.discrete, "learn" if record.module else "", record.source,
        ]
        for record in RECORDS
    ]  # fmt: skip


@pytest.mark.parametrize(("absent", "names"), [("torch", ("gp_ei", "gp_ucb", "gp_me")), ("botorch", ("gp_me",))])
def test_what_is_not_installed_is_said_before_there_is_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, absent: str, names: tuple[str, ...]
) -> None:
    monkeypatch.setattr(records, "find_spec", lambda name: None if name == absent else name)
    for name in names:
        with pytest.raises(InputError, match=f"the sampler {name} needs") as caught:
            make_tune_plan(TuneOptions(write_bench(tmp_path), sampler=name, out=tmp_path / "runs"))
        assert "pip install '.[learn]'" in caught.value.hint and "tpe_cma" in caught.value.hint
        assert caught.value.key == "tune.sampler"
    assert not (tmp_path / "runs").exists()
    check_sampler("gp_ei" if absent == "botorch" else "tpe_relative")


def test_several_objectives_need_a_sampler_for_them() -> None:
    for record in RECORDS:
        if record.objectives:
            assert record.module or check_sampler(record.name, 2) is None
        elif not record.module:
            with pytest.raises(InputError, match="searches one objective, not 2") as caught:
                check_sampler(record.name, 2)
            assert "nsga" in caught.value.hint and record.name not in caught.value.hint.split(", ")


@pytest.mark.parametrize("kappa_w", [0.0, -1.0, float("nan"), float("inf")])
def test_the_weight_of_the_uncertainty_is_above_0(kappa_w: float) -> None:
    with pytest.raises(InputError, match="kappa_w") as caught:
        check_settings(settings("random")._replace(kappa_w=kappa_w))
    assert caught.value.key == "tune.kappa_w"


def test_only_gp_ucb_stores_the_weight() -> None:
    """Studies of earlier versions have none."""
    first, other = (settings("gp_ucb")._replace(kappa_w=kappa_w).as_data() for kappa_w in (2.0, 3.0))
    assert list(describe_differences(first, other)) == ["kappa_w"]
    plain = settings("tpe_relative")._replace(kappa_w=3.0).as_data()
    assert "kappa_w" not in plain
    assert describe_differences(plain, settings("tpe_relative").as_data()) == {}
