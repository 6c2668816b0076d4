"""What of a physics' folder goes into a net's: nothing that the net was taught already."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from tests.plant.model_files import arrays_of
from tunefree_hil.base.contracts import Link, links_of
from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.config.schema import EffectSpec
from tunefree_hil.effects import catalogue
from tunefree_hil.learn.model_folder import CALIBRATION_LOGS, LearnedModel, write_learned_model
from tunefree_hil.plant.learned.weights_file import save_plant


@pytest.mark.parametrize("kind", ["hybrid", "physics"])
def test_a_net_has_learned_every_lateness_that_its_own_logs_told_and_physics_none(
    kind: str, repo: Path, tmp_path: Path
) -> None:
    told = [EffectSpec(name=name, params={}, provenance={"by": CALIBRATION_LOGS}) for name in catalogue()]
    physics = msgspec.structs.replace(load_model(repo / "bench_configs" / "models" / "mkz_nominal"), effects=told)
    arrays = None if kind == "physics" else arrays_of(kind)
    folder = write_learned_model(tmp_path / kind, LearnedModel(kind, load_vehicle("mkz_bywire"), physics, arrays), {})
    kept = [one.name for one in load_model(folder).effects]
    late = {name for name, effect in catalogue().items() if links_of(effect)[0] is Link.CLOCK}
    assert {"report_latency", "ins_latency"} <= late
    assert kept == [name for name in catalogue() if kind == "physics" or name not in late]


@pytest.mark.parametrize("kind", ["hybrid", "paper"])
def test_a_nets_file_is_that_of_the_plant(kind: str, repo: Path, tmp_path: Path) -> None:
    physics = load_model(repo / "bench_configs" / "models" / "mkz_nominal")
    learned = LearnedModel(kind, load_vehicle("mkz_bywire"), physics, arrays_of(kind), sample_spacing_s=0.05)
    folder = write_learned_model(tmp_path / kind, learned, {})
    save_plant(tmp_path / "plant.npz", kind, arrays_of(kind))
    assert (folder / "plant.npz").read_bytes() == (tmp_path / "plant.npz").read_bytes()
    assert load_model(folder).plant.params.get("sample_spacing_s") == (0.05 if kind == "paper" else None)
