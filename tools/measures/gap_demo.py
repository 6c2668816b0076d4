"""One hidden effect from end to end: tuned on a model that lacks it, named from a log, repaired, tuned again.

The car is one of the exam's (tools/gap_exam), which shares no code with models and effects here; all that is done to it
is done by the commands a user would paste, each in a process of its own. What was finished is not done again.
Searched are the seven usual roads and an evasion: who never searched one comes to numbers that say nothing of one.
On eight roads 60 tries of eleven numbers come to poor ones on either model, so there are 600.
"""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path
from statistics import median
from typing import Any

import msgspec

from tools.measures._ledger import FIGURES, FOLDER, ROOT
from tools.measures._summary import machine, rounded, summary
from tools.measures.figures.demonstration import ParameterSetResult, draw_demonstration
from tunefree_hil.figures.style import save
from tunefree_hil.jobs.run_folder import read_json

VALUE = "score on the vehicle after tuning on the repaired model, as a share of that on the old one (by search)"
NAME = "gap_demo"
PYTHON = sys.executable
EXAM = [PYTHON, "-m", "tools.gap_exam"]
TOOL = [PYTHON, "-m", "tunefree_hil"]
SEARCHED = ["left_turn", "right_turn", "u_turn", "side_pass", "serpentine", "speed_changes", "stop_and_go"]
UNSEEN = [
    "left_turn_fast", "right_turn_slow", "u_turn_wide", "lane_change_12mps", "double_lane_change", "stop_from_12mps",
]  # fmt: skip
EVASION = "double_lane_change"  # of the unseen roads; the searched ones have its mirror image, slower
SLOWER = 0.9  # times its speed
OLD, REPAIRED = "old", "repaired"


def measure(
    effect: str = "steer_dead_time=0.13", vehicle: int = 1, domain: str = "dev:demo", trials: int = 600, seeds: int = 5,
    folder: str = FOLDER, figures: str = FIGURES,
) -> dict[str, Any]:  # fmt: skip
    """effect: as `python -m tools.gap_exam make --effect` has it; vehicle: number of the exam's pool of that domain;
    seeds: searches on either model.
    """
    before = machine()
    place = Path(folder).resolve() / NAME / f"{domain.replace(':', '-')}-{vehicle}-{effect}-{trials}"
    place.mkdir(parents=True, exist_ok=True)
    _car(place, ["--domain", domain, "--vehicle", str(vehicle), "--effect", effect])
    answer = _answer(place)
    models = {OLD: place / "model"}
    if answer["model"]:
        models[REPAIRED] = (place / "gap" / answer["model"]).resolve()
    verified = {
        name: [_verified(place, name, model, trials, seed) for seed in range(1, seeds + 1)]
        for name, model in models.items()
    }
    tuned = {name: [_driven(one, "tuned") for one in some] for name, some in verified.items()}
    first = verified[OLD][0]
    best = min((which for which in first["scores"] if which != "tuned"), key=lambda which: first["scores"][which])
    manual = _driven(first, best)
    save(draw_demonstration(answer["signals"], tuned, manual, _sentence(effect, answer)), Path(figures) / f"{NAME}.png")
    detail = {
        "machine": before,
        "hidden": effect,
        "verdict": answer["verdict"],
        "effects": answer["effects"],
        "set": answer["set"],
        "explained_frac": answer["explained_frac"],
        "signals": answer["signals"],
        "outcome": read_json(place / "said.json")["outcome"],
        "tuned": {name: [one._asdict() for one in some] for name, some in tuned.items()},
        "median": {name: median(one.score for one in some) for name, some in tuned.items()},
        "holds": {name: sum(one.is_without_failures for one in some) for name, some in tuned.items()},
        "manual": {"set": best, **manual._asdict()},
    }
    if REPAIRED not in tuned:
        return {"value": float("nan"), "unit": "1", "n": 0, "low": None, "high": None, "detail": rounded(detail)}
    ratios = [new.score / old.score for old, new in zip(tuned[OLD], tuned[REPAIRED], strict=True)]
    return summary(ratios, "1", rounded(detail))


def _car(place: Path, asked: list[str]) -> None:
    """Vehicle folder, clean logs, the log with the effect; the car for the bench; model and map of the clean logs."""
    question, clean = place / "car", [str(place / "car" / f"clean_{kind}.log") for kind in ("ordinary", "excited")]
    _done(place, question / "sealed.json", [*EXAM, "make", *asked, "--out", str(question)])
    _done(place, place / "hidden" / "model.toml", [*EXAM, "bench", *asked, "--out", str(place / "hidden")])
    for command, out, last in (("calibrate", "model", "model.toml"), ("map", "map", "calibration.npz")):
        words = [*TOOL, command, *clean, "--vehicle", str(question / "vehicle"), "--out", str(place / out), "--plain"]
        _done(place, place / out / last, words)


def _answer(place: Path) -> dict[str, Any]:
    """What `gap` says; only then is the truth opened."""
    car, out = place / "car", place / "gap"
    words = [*TOOL, "gap", str(car / "drive.log"), "--vehicle", str(car / "vehicle"), "--model", str(place / "model")]
    _done(place, out / "gap.json", [*words, "--out", str(out), "--plain"], allowed=(0, 1))
    opened = [*EXAM, "open", "--out", str(car), "--answer", str(out / "gap.json")]
    text = subprocess.run(opened, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    (place / "said.json").write_text(text)
    return read_json(out / "gap.json")


def _verified(place: Path, name: str, model: Path, trials: int, seed: int) -> dict[str, Any]:
    """What a search on a model came to, driven on the vehicle over roads that no search saw: its verify.json."""
    bench, runs = place / f"{name}_{seed}.toml", place / f"runs_{name}_{seed}"
    spec = {
        "schema": "tunefree.bench/1",
        "vehicle": str(place / "car" / "vehicle"),
        "model": str(model),
        "verify_model": str(place / "hidden"),
        "scenarios": [*SEARCHED, str(mirrored(place))],
        "verify_scenarios": UNSEEN,
        "weights": "default",
        "seed": seed,
        "controller": {
            "lateral": "lqr", "longitudinal": "pid", "inner": "mrac", "riccati": "converged",
            "calibration": str(place / "map" / "calibration.npz"),
        },
        "tune": {"set": "complete", "trials": trials, "sampler": "tpe_independent"},
    }  # fmt: skip
    bench.write_bytes(msgspec.toml.encode(spec))
    begun = sorted(runs.glob("*/run.json"))
    goes_on = ["--resume", str(begun[0].parent)] if begun else [str(bench)]
    if not list(runs.glob("*/verify.json")):
        _run(place, [*TOOL, "tune", *goes_on, "--backend", "batch", "--out", str(runs), "--plain"], allowed=(0, 1))
    return read_json(next(runs.glob("*/verify.json")))


def mirrored(place: Path) -> Path:
    """The evasion to the other side, and slower, as a scenario file: what is searched on is not what is driven."""
    path = place / "evasion.toml"
    spec = tomllib.loads((ROOT / "bench_configs" / "scenarios" / f"{EVASION}.toml").read_text())
    spec["name"], spec["description"] = "evasion", "Searched: evade to the right and come back faster"
    spec["noise_seed"] += 100
    spec["start"]["speed_mps"] *= SLOWER
    spec["speed"]["value"] = [SLOWER * one for one in spec["speed"]["value"]]
    spec["speed"]["t_s"] = [one / SLOWER for one in spec["speed"]["t_s"]]
    spec["curvature"]["t_s"] = [one / SLOWER for one in spec["curvature"]["t_s"]]
    spec["curvature"]["value"] = [-one for one in spec["curvature"]["value"]]
    path.write_bytes(msgspec.toml.encode(spec))
    return path


def _driven(verified: dict[str, Any], which: str) -> ParameterSetResult:
    """One set of numbers of a verify.json."""
    drives = verified["scenarios"][which]
    return ParameterSetResult(
        verified["scores"][which],
        {scenario: drive["score"] for scenario, drive in drives.items()},
        sum(drive["replans"] for drive in drives.values()),
        sum(drive["outcome"] != "finished" for drive in drives.values()),
    )


def _done(place: Path, result: Path, words: list[str], allowed: tuple[int, ...] = (0,)) -> None:
    """Run a command unless what it writes last is there."""
    if not result.is_file():
        _run(place, words, allowed)


def _run(place: Path, words: list[str], allowed: tuple[int, ...] = (0,)) -> None:
    print(" ".join(words), file=sys.stderr, flush=True)
    with (place / "commands.log").open("a") as log:
        log.write(" ".join(words) + "\n")
        log.flush()
        status = subprocess.run(words, cwd=ROOT, stdout=log, stderr=subprocess.STDOUT, check=False).returncode
    if status not in allowed:
        raise RuntimeError(f"status {status} of {' '.join(words)}; see {place / 'commands.log'}")


def _sentence(effect: str, answer: dict[str, Any]) -> str:
    """'Hidden: steer_dead_time=0.18. Named: steer_dead_time, delay_s 0.18 (0.178 to 0.182) s'."""
    names = []
    for one in answer["effects"]:
        values = [
            f"{key} {value['value']:.3g} ({value['low']:.3g} to {value['high']:.3g}) {value['unit']}"
            for key, value in one["params"].items()
        ]
        names.append(f"{one['name']}, {', '.join(values)}")
    said = "; ".join(names) or " or ".join(answer["set"]) or answer["verdict"]
    return f"Hidden: {effect}. Named: {said}"
