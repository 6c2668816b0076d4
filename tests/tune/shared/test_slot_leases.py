"""Claims on slots in a real PostgreSQL: kept alive by beats, given back for good, free where nobody touches them."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
import sqlalchemy

from tests.tune.postgres import needs_server, running
from tunefree_hil.tune.shared.server import open_engine, parse_address
from tunefree_hil.tune.shared.slot_leases import SlotLeases

pytestmark = needs_server(120)
GRACE_S = 2.0


@pytest.fixture(scope="module")
def engine() -> Iterator[sqlalchemy.Engine]:
    with running() as server:
        engine = open_engine(parse_address(server.url("claims")))
        yield engine
        engine.dispose()


@pytest.fixture
def pair(engine: sqlalchemy.Engine, request: pytest.FixtureRequest) -> tuple[SlotLeases, SlotLeases]:
    """Two workers of one study, which is this test's own."""
    one, other = (SlotLeases(engine, request.node.name, grace_s=GRACE_S) for _ in range(2))
    one.create_table()
    return one, other


def test_a_slot_that_is_given_back_stays_free_whenever_the_next_beat_is(pair: tuple[SlotLeases, SlotLeases]) -> None:
    one, other = pair
    assert one.acquire(0) and not other.acquire(0)
    with one.keep_renewed(0):
        one.release(0)
        time.sleep(GRACE_S)  # some beats
    assert other.acquire(0)


def test_a_claim_that_is_kept_alive_outlives_its_grace(pair: tuple[SlotLeases, SlotLeases]) -> None:
    one, other = pair
    assert one.acquire(0) and one.acquire(1)
    with one.keep_renewed(0):
        time.sleep(2.0 * GRACE_S)
        assert not other.acquire(0)
        assert other.acquire(1), "nobody touched this one"


def test_a_row_that_a_server_lost_is_taken_again_by_the_next_beat(
    pair: tuple[SlotLeases, SlotLeases], engine: sqlalchemy.Engine
) -> None:
    one, other = pair
    assert one.acquire(0)
    with engine.begin() as connection:
        connection.execute(sqlalchemy.text("DELETE FROM tunefree_claims"))
    one.renew(0)
    assert not other.acquire(0)
