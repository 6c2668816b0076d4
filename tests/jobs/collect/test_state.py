"""Which gentle stretches a drive is given: one beside cells, several where none is left, each once, counted by logs."""

from __future__ import annotations

from pathlib import Path

import pytest

from tunefree_hil.collect.gentle_driving import MAX_STRETCHES_A_DRIVE
from tunefree_hil.jobs.collect.plan import open_folder, resolve_setup, run_record, write_bench
from tunefree_hil.jobs.collect.state import Collection
from tunefree_hil.jobs.options.records import CollectOptions


@pytest.fixture
def collection(tmp_path: Path) -> Collection:
    asked = CollectOptions(vehicle="mkz_bywire", model="mkz_nominal", bus="tfhub", out=tmp_path / "run")
    setup = resolve_setup(asked)
    run = open_folder(setup.vehicle, asked, run_record(setup, asked))
    return Collection(run, write_bench(run, setup, asked), asked)


def test_one_beside_cells_and_several_where_none_is_left(collection: Collection) -> None:
    wanted = len(collection.stretches)
    assert wanted > MAX_STRETCHES_A_DRIVE and collection.next_stretches == (0, 1) and collection.wants_more
    assert f"0 of {wanted} gentle stretches" in collection.progress_text
    collection.gentle_count = 4
    assert collection.next_stretches == (4, 5)
    collection.coverage.counter.missing = 0
    assert collection.wants_more and collection.next_stretches == (4, 4 + MAX_STRETCHES_A_DRIVE)
    collection.gentle_count = wanted - 1
    assert collection.next_stretches == (wanted - 1, wanted)
    collection.gentle_count = wanted
    assert not collection.wants_more and collection.next_stretches == (wanted, wanted)
    assert all(one["driven"] for one in collection.as_dict()["gentle"])


def test_cells_go_on_when_all_stretches_are_driven(collection: Collection) -> None:
    collection.gentle_count = len(collection.stretches)
    assert collection.wants_more and collection.next_stretches[0] == collection.next_stretches[1]
