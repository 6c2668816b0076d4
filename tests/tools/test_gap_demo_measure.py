"""The demonstration of gap searches on roads that it does not drive afterwards, an evasion among them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tools.measures.gap_demo import EVASION, SEARCHED, SLOWER, UNSEEN, mirrored
from tunefree_hil.config.load import load_scenario


def test_the_searched_evasion_is_the_mirror_image_of_the_unseen_one_and_slower(tmp_path: Path) -> None:
    searched, unseen = load_scenario(str(mirrored(tmp_path))), load_scenario(EVASION)
    assert searched.name not in {*SEARCHED, *UNSEEN} and searched.noise_seed != unseen.noise_seed
    assert searched.start.speed_mps == SLOWER * unseen.start.speed_mps
    along = [
        np.asarray(one.curvature.t_s) * np.asarray(one.speed.value[0]) for one in (searched, unseen)
    ]  # metres of road: the speed is constant
    np.testing.assert_allclose(along[0], along[1])
    np.testing.assert_allclose(searched.curvature.value, -np.asarray(unseen.curvature.value))


def test_no_road_is_both_searched_and_driven() -> None:
    assert not set(SEARCHED) & set(UNSEEN) and EVASION in UNSEEN
