"""A verification that disappoints ends with the `gap` command to paste, in the last words and on the page."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import pytest

from tests.jobs.made_chain import Chain, asked, chain
from tunefree_hil.jobs.commission.next_gap_command import find_shortfall
from tunefree_hil.jobs.commission.plan import make_plan
from tunefree_hil.jobs.commission.stages import select_result
from tunefree_hil.jobs.options.records import CommissionOptions

__all__ = ["asked", "chain"]  # fixtures


def held(calm: bool) -> dict[str, Any]:
    """What `tune` says of a winner that drove the learned plant without a re-plan, or did not."""
    slower = {"score": 0.4, "replans": 0, "failed": 0}
    winner = {"key": "t0", "slot": 0, "score": 0.2, "mean": 0.3, "calm": calm, "slower": slower, "holds": calm}
    data = {"factor": 1.5, "reason": "", "driven": 1, "holding": int(calm), "winner": winner}
    return {"held": {**data, "passed_over": [], "baselines": {}}}


def driven(replans: int) -> dict[str, Any]:
    """What `verify` says of a winner that re-planned so often on the vehicle."""
    return {"scenarios": {"tuned": {"left": {"replans": replans}, "right": {"replans": 0}}}}


CALM = held(True)


def verify_drives(asked: CommissionOptions, count: int) -> list[Path]:
    """The logs of a verification in the commission's folder: so many winner's and baselines' drives."""
    assert asked.out is not None
    run = asked.out / "tune" / "1-tune-bench"
    logs = [run / "verify" / "episodes" / str(k) / "vehicle.log" for k in range(count)]
    for log in logs:
        log.parent.mkdir(parents=True)
        log.write_text("")
    (run / "run.json").write_text(json.dumps({"complete": True}))
    return logs


def ended(chain: Chain, asked: CommissionOptions) -> tuple[dict[str, Any], list[Path]]:
    """(data, the winner's logs) of a commission whose verification left drives."""
    assert asked.out is not None
    chain.run(asked._replace(only="collect"))
    roads = len(make_plan(asked).template.verify_scenarios)
    logs = verify_drives(asked, 3 * roads)[:roads]
    return chain.run(asked), logs


@pytest.mark.parametrize(
    ("tune", "verify", "said"),
    [
        ({}, {"holds": False}, "fail the verification on the vehicle"),
        (CALM, driven(2), "re-plans 2 times on the vehicle and never on the learned plant"),
    ],
)
def test_the_command_stands_in_the_last_words_and_on_the_page(
    tune: dict[str, Any], verify: dict[str, Any], said: str, chain: Chain, asked: CommissionOptions
) -> None:
    chain.results["tune"] |= tune
    chain.results["verify"] |= verify
    data, logs = ended(chain, asked)
    assert asked.out is not None
    assert said in data["sentence"] and "`gap`" in data["sentence"]
    (command,) = data["next"]
    words = shlex.split(command)
    assert words[:2] == ["tunefree-hil", "gap"] and words[2 : 2 + len(logs)] == [str(log) for log in logs]
    options = dict(zip(words[2 + len(logs) :: 2], words[3 + len(logs) :: 2], strict=False))
    assert options["--model"] == str(asked.out / "model") and options["--out"] == str(asked.out / "gap")
    assert Path(options["--vehicle"]).name == "mkz_bywire"
    assert words[-3:] == ["--drive", "--bench", str(asked.out / "bench.toml")]
    page = Path(data["report"]).read_text()
    assert command in page and said in page


@pytest.mark.parametrize(
    ("tune", "verify"),
    [
        (CALM, driven(0)),
        (held(False), driven(4)),  # it did so on the plant: nothing is missing there
        ({}, driven(4)),
    ],
)
def test_a_winner_that_does_as_on_the_plant_offers_nothing(
    tune: dict[str, Any], verify: dict[str, Any], chain: Chain, asked: CommissionOptions
) -> None:
    chain.results["tune"] |= tune
    chain.results["verify"] |= verify
    data, _ = ended(chain, asked)
    assert data["next"] == [] and "`gap`" not in data["sentence"]
    assert "tunefree-hil gap" not in Path(data["report"]).read_text()


def test_without_logs_there_is_no_command_to_offer(chain: Chain, asked: CommissionOptions) -> None:
    chain.results["verify"]["holds"] = False
    data = chain.run(asked)
    assert data["exit"] == 1 and data["next"] == [] and "`gap`" not in data["sentence"]


def test_what_is_not_verified_does_not_disappoint() -> None:
    assert find_shortfall({}) is None and find_shortfall({"tune": {"result": CALM}}) is None


def test_the_record_keeps_how_often_the_winner_re_planned(tmp_path: Path) -> None:
    drives = {"left": {"replans": 2}, "right": {"replans": 1}}
    assert select_result({"scenarios": {"tuned": drives, "as_shipped": {}}, "sentence": "x"}, tmp_path)["replans"] == 3
    assert "replans" not in select_result({"sentence": "x"}, tmp_path)
