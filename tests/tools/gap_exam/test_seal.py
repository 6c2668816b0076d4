"""Truths under seal: opened after the answer only, and as they were sealed; seeds that never meet."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tools.gap_exam.files import Run, read_json, write_json
from tools.gap_exam.seal import Broken, StillSealed, commitment, open_truth, put_away, seal, unseal
from tools.gap_exam.seeds import Domain, domain_of

TRUTH = {"row": "one", "effects": {"steer_lag": {"tau_s": 0.123}}}
NONCE = "0123456789abcdef" * 2
COMMIT = "a" * 40


def test_a_sealed_truth_shows_nothing_and_comes_back_whole() -> None:
    sealed = seal(TRUTH, NONCE)
    text = json.dumps(sealed)
    assert "steer" not in text and "effects" not in text
    assert b"steer" not in bytes.fromhex(sealed["sealed"])
    assert unseal(sealed) == TRUTH
    assert sealed["commitment"] == commitment(json.dumps(TRUTH, sort_keys=True), NONCE)
    assert seal(TRUTH, "f" * 32)["commitment"] != sealed["commitment"]


@pytest.mark.parametrize("key", ["commitment", "nonce", "sealed"])
def test_a_changed_seal_is_broken(key: str) -> None:
    sealed = seal(TRUTH, NONCE)
    first = "0" if sealed[key][0] != "0" else "1"
    with pytest.raises(Broken):
        unseal({**sealed, key: first + sealed[key][1:]})


def test_it_is_opened_only_after_the_answer(tmp_path: Path) -> None:
    run = Run(tmp_path)
    promised = put_away(run, 7, TRUTH, NONCE)
    assert put_away(run, 7, {"another": 1}, "e" * 32) == promised, "sealed once"
    with pytest.raises(StillSealed):
        open_truth(run, 7)
    write_json(run.answer(7) / "gap.json", {"verdict": "none_missing"})
    with pytest.raises(StillSealed):
        open_truth(run, 7)
    write_json(run.answer(7) / "run.json", {"status": 0, "seconds": 1.0})
    assert open_truth(run, 7) == TRUTH


def test_what_is_written_is_whole_or_not_there(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b.json"
    write_json(path, {"x": 1})
    write_json(path, {"x": 2})
    assert read_json(path) == {"x": 2} and [one.name for one in path.parent.iterdir()] == ["b.json"]
    with pytest.raises(ValueError):
        write_json(path, {"x": float("nan")})
    assert read_json(path) == {"x": 2}


def test_domains_are_apart() -> None:
    """An exam's seeds come from a commit, development's from a name; the same use in both is another seed."""
    exam, other, trial = Domain("exam", COMMIT), Domain("exam", "b" * 40), Domain("dev", "trial")
    seeds = [domain.seed("vehicle", number) for domain in (exam, other, trial) for number in range(200)]
    assert len(set(seeds)) == len(seeds)
    assert exam.seed("vehicle", 3) == Domain("exam", COMMIT).seed("vehicle", 3) != exam.seed("order", 3)
    assert exam.seed("a", "bc") != exam.seed("ab", "c")
    assert str(domain_of(f"exam:{COMMIT}")) == f"exam:{COMMIT}"


@pytest.mark.parametrize(
    "text", ["exam:abc", f"dev:{COMMIT}", "dev:", "exam", "test:x", "dev:A b", f"exam:{COMMIT[:39]}g"]
)
def test_a_domain_is_one_or_the_other(text: str) -> None:
    """No name of development can be a commit: it would be 40 letters long."""
    with pytest.raises(ValueError):
        domain_of(text)
