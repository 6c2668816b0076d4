"""The tool that makes the learned models, without what takes minutes; and the models that lie in bench_configs."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.house import ROOT
from tests.plant.model_files import write_model
from tools import make_models as tool
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import load, model_of
from tunefree_hil.config.load import load_bench, load_model, load_vehicle

SHIPPED = sorted(path.parent for path in tool.MODELS.glob("*/card.json"))
LEARNED = [load_bench(path) for path in sorted((ROOT / "bench_configs").glob("*.toml"))]
LEARNED = [spec for spec in LEARNED if tool.MODELS / spec.model in SHIPPED]
# those with made roads or with other parameters have no counterpart
BENCHES = [Path(spec.path) for spec in LEARNED if spec.roads is None and spec.tune.set]
DRIVEN_S = 5.0


def test_every_vehicle_that_can_be_driven_has_a_learned_model_and_a_bench_on_it() -> None:
    plans = tool.plans(tool.Asked())
    assert len(plans) >= 2
    first, *others = ({tool.name_of(plan.stem, kind) for plan in plans} for kind in tool.KINDS)
    assert first <= {path.name for path in SHIPPED} <= first.union(*others)
    assert {load_bench(path).model for path in BENCHES} == first


@pytest.mark.parametrize("folder", SHIPPED, ids=lambda path: path.name)
def test_a_shipped_model_is_what_its_card_says(folder: Path) -> None:
    model, card = load_model(folder), json.loads((folder / tool.CARD).read_text())
    vehicle = load_vehicle(model.vehicle)
    driven = tool.driven_model(vehicle)
    assert tool.size_of(folder) < tool.LARGEST_BYTES
    assert card["files"] == tool.hashes_of(folder) and set(card["files"]) == {
        "model.toml", "plant.npz", tool.MAP, tool.STEERING_MAP_FILE,
    }  # fmt: skip
    assert model.vehicle_hash == card["vehicle_hash"] == card["map"]["vehicle_hash"] == f"sha256:{vehicle.hash}"
    assert driven is not None and card["driven"]["hash"] == f"sha256:{driven.hash}", (
        "make it anew: tools/make_models.py"
    )
    assert card["kind"] == model.plant.kind and card["seed"] == card["map"]["seed"]
    assert sum(one["seconds"] for one in card["logs"]) == pytest.approx(card["driven"]["simulated_s"])


@pytest.mark.parametrize("folder", SHIPPED, ids=lambda path: path.name)
def test_the_card_says_the_command_that_makes_it(folder: Path) -> None:
    card = json.loads((folder / tool.CARD).read_text())
    words = card["made_by"].split()
    asked, _ = tool.parsed(words[1:])
    (plan,) = tool.plans(asked._replace(vehicles=[str(ROOT / one) for one in asked.vehicles]))
    assert (ROOT / words[0]).is_file()
    assert [tool.name_of(plan.stem, kind) for kind in asked.kinds] == [folder.name] and asked.seed == card["seed"]
    assert tool.made_of(plan, card["kind"], {})["made_by"] == card["made_by"]


@pytest.mark.parametrize("path", BENCHES, ids=lambda path: path.stem)
def test_a_learned_bench_is_another_bench_of_the_vehicle_on_what_was_learned(path: Path) -> None:
    """Figures of the other bench files do not move; and the vehicle that verifies is the one that was learned from."""
    said = tomllib.loads(path.read_text())
    others = [tomllib.loads(one.read_text()) for one in path.parent.glob("*.toml") if one not in BENCHES]
    fixed = ("vehicle", "verify_model", "scenarios", "verify_scenarios", "weights", "seed", "tune")
    alike = [one for one in others if all(one.get(key) == said.get(key) for key in fixed)]
    assert alike and all(one["model"] != said["model"] for one in alike)
    bench = load(path)
    driven = tool.driven_model(bench.vehicle)
    assert driven is not None and model_of(bench, bench.spec.verify_model).hash == driven.hash


def test_make_tune_searches_on_the_learned_plant() -> None:
    named = re.search(r"^BENCH \?= (\S+)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert named is not None
    spec = load_bench(ROOT / named[1])
    assert spec in LEARNED and spec.tune.set == "complete" and spec.tune.backend == "batch"
    assert model_of(load(ROOT / named[1]), spec.model).plant.kind == "hybrid"


WITHOUT_TORCH = """
import json, sys
from pathlib import Path

class Nothing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "torch":
            raise ImportError(name)

sys.meta_path.insert(0, Nothing())
from tools.measures._in_process import InProcess
from tunefree_hil.bench import follower_of, load, model_of, parameters_of
from tunefree_hil.episode.columns import columns_from_frames
from tunefree_hil.episode.validity_region import outside

bench, found = load(sys.argv[1]), {}
scenario, values = bench.scenarios[bench.spec.scenarios[0]], parameters_of(bench)
ticks = round(float(sys.argv[2]) / bench.dt_s)
for name in sys.argv[3:]:
    drive = InProcess(bench, name).drive(scenario, values, until=ticks)
    follower = follower_of(bench, scenario, values)
    recording = columns_from_frames(drive.frames, bench.codec, follower, bench.dt_s, ticks=ticks)
    found[name] = [drive.ticks, outside(recording, model_of(bench, name).valid).share,
                   float(recording.columns["lateral_error_m"].max() - recording.columns["lateral_error_m"].min())]
print(json.dumps({"found": found, "torch": "torch" in sys.modules}))
"""


@pytest.mark.slow
@pytest.mark.parametrize("path", BENCHES, ids=lambda path: path.stem)
def test_shipped_models_drive_without_torch_inside_what_they_know(path: Path) -> None:
    names = [one.name for one in SHIPPED if load_model(one).vehicle == load_bench(path).vehicle]
    command = [sys.executable, "-c", WITHOUT_TORCH, str(path), str(DRIVEN_S), *names]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout.splitlines()[-1])
    assert not said["torch"] and set(said["found"]) == set(names)
    for name, (ticks, share, wide_m) in said["found"].items():
        assert (ticks, share) == (round(DRIVEN_S / load(path).dt_s), 0.0), name
        assert 0.0 < wide_m < 1.0, f"{name}: it drives, and on the path"


@pytest.fixture
def learned(tmp_path: Path) -> Path:
    """A folder as `learn` leaves it, figures and all."""
    folder = write_model(tmp_path / "learned", "hybrid")
    level = {"10": {"position_m": {"mean": 0.5}}}
    card = {"kind": "hybrid", "free_run": {"hybrid": {"level": level}}, "logs": [{"name": "a", "hash": "b"}]}
    (folder / tool.CARD).write_text(json.dumps(card))
    (folder / "figures").mkdir()
    (folder / "figures" / "free_run.png").write_bytes(b"x" * tool.LARGEST_BYTES)
    return folder


@pytest.fixture
def charted(tmp_path: Path) -> Path:
    """A map as `map` leaves it."""
    path = tmp_path / "map" / tool.MAP
    path.parent.mkdir()
    path.with_name(tool.STEERING_MAP_FILE).write_text("of the same logs\n")
    card = json.dumps({"schema": "tunefree.map/1", "logs": {"a": "b"}, "seed": 1})
    np.savez(path, speed_mps=[0.0], accel_mps2=[0.0], command_frac=[0.0], card=card)
    return path


def test_what_is_shipped_is_whole_small_and_says_when_nothing_changed(
    learned: Path, charted: Path, tmp_path: Path
) -> None:
    target = tmp_path / "out" / "x_learned"
    (first,) = tool.ship(learned, charted, target, {"made_by": "me"}).values()
    assert "0.50 m off" in first and "byte for byte" not in first
    names = [tool.MAP, tool.CARD, "model.toml", "plant.npz", tool.STEERING_MAP_FILE]
    assert sorted(path.name for path in target.iterdir()) == names
    assert (target / tool.MAP).read_bytes() == charted.read_bytes() != (learned / tool.MAP).read_bytes()
    card = json.loads((target / tool.CARD).read_text())
    assert card["files"] == tool.hashes_of(target) and card["made_by"] == "me" and card["map"]["seed"] == 1
    (target.parent / f"part-{target.name}").mkdir()  # an earlier call was killed here
    assert "byte for byte" in tool.ship(learned, charted, target, {})[target.name]
    (learned / "model.toml").write_text((learned / "model.toml").read_text() + "\n")
    assert "byte for byte" not in tool.ship(learned, charted, target, {})[target.name]
    assert [path.name for path in target.parent.iterdir()] == [target.name]


def test_what_will_not_do_is_not_shipped(learned: Path, charted: Path, tmp_path: Path) -> None:
    target = tmp_path / "x_learned"
    card = json.loads((learned / tool.CARD).read_text())
    card["free_run"]["hybrid"]["level"]["10"]["position_m"]["mean"] = tool.MOST_OFF_M + 1.0
    (learned / tool.CARD).write_text(json.dumps(card))
    with pytest.raises(InputError, match="off after 10 s"):
        tool.ship(learned, charted, target, {})
    (learned / tool.CARD).write_text(json.dumps({**card, "free_run": {}, "words": "x" * tool.LARGEST_BYTES}))
    with pytest.raises(InputError, match="bytes, more than"):
        tool.ship(learned, charted, target, {})
    assert not list(tmp_path.glob("*x_learned"))


def test_a_vehicle_that_nothing_stands_for_is_refused() -> None:
    with pytest.raises(InputError, match="rav4_2017") as raised:
        tool.plans(tool.Asked(vehicles=[str(ROOT / "dbc" / "rav4_2017")]))
    assert raised.value.key == "--vehicle"


class Jobs:
    """Stand-ins for the four jobs: they note that they ran and leave what the real ones do."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, learned: Path, charted: Path, cells: int) -> None:
        self.ran: list[str] = []
        self.cut_off = ""

        def leave(name: str, folder: Path, source: Path, data: dict[str, Any]) -> Iterator[Event]:
            if name == self.cut_off:
                raise KeyboardInterrupt
            self.ran.append(name)
            folder.mkdir(parents=True, exist_ok=True)
            for path in (one for one in source.iterdir() if one.is_file()):
                (folder / path.name).write_bytes(path.read_bytes())
            yield Event("line", "a product")
            yield Event("result", f"{name} done", data)

        covers = {"cells_full": cells, "cells_wanted": 100, "simulated_s": 1.0, "beyond_envelope_s": 0.0, "run": "r"}
        stand_ins = {
            "collect.collect.collect": lambda wish: leave("collect", wish.out / "logs", charted.parent, covers),
            "learn.calibrate.calibrate": lambda options: leave("calibrate", options.out, learned, {}),
            "learn.learn.learn": lambda wish: leave(f"learn {wish.kind}", wish.out, learned, {}),
            "learn.map.map_logs": lambda options: leave("map", options.out, charted.parent, {}),
        }
        for name, job in stand_ins.items():
            monkeypatch.setattr(f"tunefree_hil.jobs.{name}", job)

    def run(self, folder: Path, **more: Any) -> list[Event]:
        """Make the models of one vehicle; `ran` says what was driven and fitted for it."""
        self.ran.clear()
        asked = tool.Asked([str(ROOT / "dbc" / "mkz_bywire")], work=folder / "work", out=folder / "out", **more)
        return list(tool.make_models(asked))


def test_cut_off_it_goes_on_where_it_was(
    monkeypatch: pytest.MonkeyPatch, learned: Path, charted: Path, tmp_path: Path
) -> None:
    jobs = Jobs(monkeypatch, learned, charted, 100)
    jobs.cut_off = "learn lstm"
    with pytest.raises(KeyboardInterrupt):
        jobs.run(tmp_path)
    assert jobs.ran == ["collect", "calibrate", "map", "learn hybrid"]
    jobs.cut_off = ""
    events = jobs.run(tmp_path)
    assert jobs.ran == ["collect", "learn lstm"], "a collection counts its own logs"
    assert events[-1].kind == "result" and events[-1].data["models"] == ["mkz_learned", "mkz_learned_lstm"]
    assert all(event.kind in ("note", "result") for event in events)
    jobs.run(tmp_path, seed=2)
    assert len(jobs.ran) == 5, "other options, another folder"


def test_too_little_driving_ends_it(
    monkeypatch: pytest.MonkeyPatch, learned: Path, charted: Path, tmp_path: Path
) -> None:
    jobs = Jobs(monkeypatch, learned, charted, 70)
    with pytest.raises(InputError, match="70 of 100 cells"):
        jobs.run(tmp_path)
    assert jobs.ran == ["collect"]
