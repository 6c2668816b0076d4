"""The address of a shared study: what is read, what is shown, what is refused; and patience."""

from __future__ import annotations

import pytest
from optuna.exceptions import StorageInternalError
from sqlalchemy.exc import OperationalError, PendingRollbackError, ProgrammingError

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.tune.shared import server
from tunefree_hil.tune.shared.server import is_unreachable, parse_address, retry_while_unreachable

SECRET = "pa%40ss-word"


@pytest.fixture(autouse=True)
def driver_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server.importlib.util, "find_spec", lambda name: object())


@pytest.mark.parametrize(
    ("text", "shown", "name"),
    [
        (f"postgresql://me:{SECRET}@host:5433/tuning#steer", "postgresql://me@host:5433/tuning", "steer"),
        (f"postgres://me:{SECRET}@host/tuning", "postgresql://me@host/tuning", "tunefree"),
        ("postgresql://host/tuning?sslmode=require", "postgresql://host/tuning?sslmode=require", "tunefree"),
        (f"postgresql://me@host/tuning?password={SECRET}&x=1", "postgresql://me@host/tuning?x=1", "tunefree"),
        ("postgresql:///tuning?host=/run/pg", "postgresql:///tuning?host=/run/pg", "tunefree"),
    ],
)
def test_an_address_is_shown_without_its_password(text: str, shown: str, name: str) -> None:
    address = parse_address(text)
    assert (address.public, address.name) == (shown, name)
    assert address.url.startswith("postgresql+psycopg://") and "#" not in address.url
    assert (SECRET in text) == (SECRET in address.url)
    assert SECRET not in address.public


WRONG = (
    *("", "study.db", "postgres:x", f"mysql://me:{SECRET}@host/db", f"postgresql://me:{SECRET}@host"),
    *(f"postgresql://me:{SECRET}@host:port/db", f"postgresql://me:{SECRET}@[host/db"),
)


@pytest.mark.parametrize("text", WRONG)
def test_what_is_no_address_is_refused_without_its_password(text: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_address(text)
    assert caught.value.key == "--study" and SECRET not in str(caught.value)


def test_a_missing_driver_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'tunefree_hil\[postgres\]'"):
        parse_address("postgresql://host/db")


GONE = OperationalError("SELECT 1", {}, Exception("connection refused"))


def test_only_a_lost_server_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    slept: list[float] = []
    monkeypatch.setattr(server.time, "sleep", slept.append)
    wrapped = StorageInternalError("an exception is raised during the commit")
    wrapped.__cause__ = GONE
    asked_on = StorageInternalError("an exception is raised during the commit")
    asked_on.__cause__ = PendingRollbackError("can't reconnect until invalid transaction is rolled back")
    asked_on.__cause__.__context__ = GONE
    answers = iter([GONE, wrapped, asked_on, 7])

    def work() -> int:
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    waiting = retry_while_unreachable(work, parse_address("postgresql://host/db"), 60.0, "kept in kept.json")
    first = next(waiting)
    assert "does not answer (connection refused)" in first and "kept in kept.json" in first
    assert next(waiting) == "postgresql://host/db answers again"
    with pytest.raises(StopIteration) as done:
        next(waiting)
    assert done.value.value == 7 and slept == [0.5, 1.0, 2.0]
    assert not is_unreachable(StorageInternalError("value too long"))
    assert not is_unreachable(PendingRollbackError("of an error in the data"))
    assert not is_unreachable(ProgrammingError("SELECT 1", {}, Exception("no such table")))


def said(words: str, state: str | None) -> ProgrammingError:
    cause = Exception(words)
    cause.sqlstate = state  # type: ignore[attr-defined]
    return ProgrammingError("SELECT 1", {}, cause)


@pytest.mark.parametrize(
    ("words", "state"),
    [
        ("permission denied for schema public", "42501"),
        ('invalid connection option "sslmod"', None),
        ('connection failed: FATAL:  no pg_hba.conf entry for host "::1"', None),
    ],
)
def test_a_refusal_is_no_mistake_of_ours_and_not_waited_for(words: str, state: str | None) -> None:
    def work() -> None:
        raise said(words, state)

    with pytest.raises(InputError, match="refuses: ") as caught:
        list(retry_while_unreachable(work, parse_address("postgresql://host/db"), 60.0))
    assert caught.value.code == "study_refused" and "may the user make tables" in caught.value.hint


def test_what_the_server_finds_wrong_in_a_question_is_a_mistake_of_ours() -> None:
    def work() -> None:
        raise said('relation "trials" does not exist', "42P01")

    with pytest.raises(ProgrammingError):
        list(retry_while_unreachable(work, parse_address("postgresql://host/db"), 60.0))


def test_patience_ends() -> None:
    def work() -> None:
        raise GONE

    with pytest.raises(BenchError, match=r"does not answer, for 0 s \(connection refused\); kept in kept") as caught:
        list(retry_while_unreachable(work, parse_address("postgresql://host/db"), 0.4, "kept in kept.json"))
    assert caught.value.exit_status == 3 and "same command" in caught.value.hint
