"""Kind `rule_based`: the map read forwards says what it was made of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.plant.drives import CHANNELS, PLANTS, REST, command, drive
from tests.plant.model_files import NOMINAL
from tunefree_hil.base.course import Start
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.open_loop_map import value_at
from tunefree_hil.plant.rule_based import load_map, open_rule_based
from tunefree_hil.plant.vehicle import assemble, steady_accel


def test_it_is_the_file_read_forwards(tmp_path: Path) -> None:
    path = tmp_path / "calibration.npz"
    np.savez(path, speed_mps=[0.0, 0.0, 10.0, 10.0], accel_mps2=[-1.0, 1.0, -2.0, 0.0], command_frac=[-0.5, 0.5] * 2)
    forward = load_map(path)
    assert value_at(forward, 0.0, 0.0) == 0.0 and value_at(forward, 5.0, 0.0) == pytest.approx(-0.5)
    assert value_at(forward, 20.0, 0.9) == 0.0 and value_at(forward, -1.0, -0.9) == -1.0


@pytest.mark.parametrize("speed", [1.0, 5.0, 12.0])
@pytest.mark.parametrize(("throttle", "brake"), [(REST, REST), (0.3, REST), (0.6, REST), (REST, 0.22), (REST, 0.3)])
def test_it_is_the_car_that_the_map_was_made_of(speed: float, throttle: float, brake: float) -> None:
    plant = open_rule_based(NOMINAL / "calibration.npz")
    found = steady_accel(plant, {}, speed, throttle, brake)
    assert found == pytest.approx(steady_accel(PLANTS["physics"], {}, speed, throttle, brake), abs=0.06)


def test_it_turns_as_a_bicycle_does() -> None:
    body = assemble(open_rule_based(NOMINAL / "calibration.npz"), {}, CHANNELS)
    last = drive(body, lambda t: command(0.25, REST, 3.2), 3.0, start=Start(speed_mps=5.0))[-1].motion
    assert last.yaw_rate_radps == pytest.approx(last.speed_mps * np.tan(0.2) / 2.8448, rel=1e-3)
    assert last.side_speed_mps == pytest.approx(1.4224 * last.yaw_rate_radps)


@pytest.mark.parametrize("content", [None, "", "map"])
def test_a_file_that_is_no_map(content: str | None, tmp_path: Path) -> None:
    path = tmp_path / "calibration.npz"
    if content is not None:
        path.write_text(content)
    with pytest.raises(InputError) as caught:
        open_rule_based(path)
    said = ("no_plant_file", "plant.file") if content is None else ("bad_plant_file", "")
    assert (caught.value.code, caught.value.key) == said
    assert caught.value.file == str(path) and "calibration.npz" in caught.value.hint
