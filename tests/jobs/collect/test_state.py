"""Which gentle stretches a drive is given: one beside cells, several where none is left, each once, counted by logs."""

from __future__ import annotations

from pathlib import Path

import pytest

from tunefree_hil.collect.gentle_driving import TOGETHER
from tunefree_hil.jobs.collect.plan import Asked, open_folder, prepare, record_of, vehicle_and_model
from tunefree_hil.jobs.collect.state import Collection


@pytest.fixture
def collection(tmp_path: Path) -> Collection:
    asked = Asked(vehicle="mkz_bywire", model="mkz_nominal", bus="tfhub", out=tmp_path / "run")
    vehicle, model, effects = vehicle_and_model(asked)
    run = open_folder(vehicle, asked, record_of(vehicle, model, asked, effects))
    return Collection(run, prepare(run, vehicle, model, asked, effects), asked)


def test_one_beside_cells_and_several_where_none_is_left(collection: Collection) -> None:
    wanted = len(collection.stretches)
    assert wanted > TOGETHER and collection.next_stretches == (0, 1) and collection.wants_more
    assert f"0 of {wanted} stretches" in collection.words
    collection.gentle = 4
    assert collection.next_stretches == (4, 5)
    collection.coverage.counter.missing = 0
    assert collection.wants_more and collection.next_stretches == (4, 4 + TOGETHER)
    collection.gentle = wanted - 1
    assert collection.next_stretches == (wanted - 1, wanted)
    collection.gentle = wanted
    assert not collection.wants_more and collection.next_stretches == (wanted, wanted)
    assert all(one["driven"] for one in collection.as_dict()["gentle"])


def test_cells_go_on_when_all_stretches_are_driven(collection: Collection) -> None:
    collection.gentle = len(collection.stretches)
    assert collection.wants_more and collection.next_stretches[0] == collection.next_stretches[1]
