"""The first vehicle of the project and a bench of two seconds, read once."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tunefree_hil.bench import Bench, load
from tunefree_hil.bus.dbc.codec import Codec


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the bench file b.toml."""
    folder = tmp_path_factory.mktemp("tiny")
    write_bench(folder)
    return folder


@pytest.fixture(scope="session")
def bench(tiny: Path) -> Bench:
    return load(tiny / "b.toml")


@pytest.fixture(scope="session")
def codec(bench: Bench) -> Codec:
    return bench.codec
