"""The server of a shared study: PostgreSQL addresses, connections, and retries while the server is unreachable."""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import time
import warnings
from collections.abc import Callable, Generator, Iterator
from typing import Any, NamedTuple, TypeVar
from urllib.parse import SplitResult, parse_qsl, urlencode, urlsplit, urlunsplit

import sqlalchemy
from optuna.exceptions import StorageInternalError
from optuna.storages import RDBStorage
from sqlalchemy.exc import ArgumentError, InterfaceError, OperationalError, PendingRollbackError, SQLAlchemyError

from tunefree_hil.base.errors import BenchError, InputError

STUDY_NAME = "tunefree"
SCHEMES = ("postgresql", "postgres")
CONNECT_LIMIT_S = 5
_CONNECT = {
    "connect_timeout": CONNECT_LIMIT_S,
    "client_encoding": "utf8",  # a database in SQL_ASCII returns bytes
    # for a connection that breaks during a query: libpq itself would wait for a quarter of an hour
    "tcp_user_timeout": 20_000,  # ms; the others in s
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 2,
}
FIRST_WAIT_S, LONGEST_WAIT_S = 0.5, 8.0
# SQLSTATE of authentication, unknown database, missing privilege; before a connection the driver gives a text only
REFUSING_STATES = ("28", "3D", "42501")
REFUSING_WORDS = (
    *("authentication failed", "does not exist", "no password", "permission denied", "pg_hba.conf"),
    *("invalid connection option", "invalid sslmode value"),
)
LOCK = 0x7F5E  # key of the advisory lock under which tables are made and slots are completed

R = TypeVar("R")


class StudyAddress(NamedTuple):
    """url: for the driver, with the password. public: for messages, without it. name: of the study in the database."""

    url: str
    public: str
    name: str


def parse_address(text: str) -> StudyAddress:
    """Parse `postgresql://[USER[:PASSWORD]@]HOST[:PORT]/DATABASE[?OPTIONS][#STUDY]`.

    Without #STUDY the study in the database is called `tunefree`. Raises InputError; the message has no password.
    """
    hint = "--study postgresql://USER@HOST/DATABASE, with the password in PGPASSWORD or ~/.pgpass"
    try:
        parts = urlsplit(text)
        user = parts.username
        parts.port  # noqa: B018 - ValueError where it is no number
        sqlalchemy.make_url(text.partition("#")[0])
    except (ValueError, ArgumentError):
        raise InputError("the address cannot be read", code="bad_study", key="--study", hint=hint) from None
    if parts.scheme not in SCHEMES or not parts.path.strip("/"):
        scheme = f"{parts.scheme}://..." if parts.scheme else "no scheme"
        message = f"a shared study is in PostgreSQL; this is {scheme}, or names no database"
        raise InputError(message, code="bad_study", key="--study", hint=hint)
    if importlib.util.find_spec("psycopg") is None:
        raise InputError(
            "PostgreSQL's driver is not installed",
            code="missing_extra",
            key="--study",
            hint="pip install 'tunefree_hil[postgres]'",
        )
    plain = parts._replace(fragment="")
    host = parts.netloc.rpartition("@")[2]
    options = [(key, value) for key, value in parse_qsl(parts.query) if key != "password"]
    bare = plain._replace(netloc=f"{user}@{host}" if user else host, query=urlencode(options, safe="/"))
    url, public_url = _spelled(plain, "postgresql+psycopg"), _spelled(bare, "postgresql")
    return StudyAddress(url, public_url, parts.fragment or STUDY_NAME)


def _spelled(parts: SplitResult, scheme: str) -> str:
    """`urlunsplit` that keeps the slashes of an empty host (a socket is then in the options)."""
    text = urlunsplit(parts._replace(scheme=scheme))
    return text if "://" in text else text.replace(":", "://", 1)


def open_engine(address: StudyAddress) -> sqlalchemy.Engine:
    """Connections to the server; each is tested before use."""
    url = sqlalchemy.make_url(address.url)
    return sqlalchemy.create_engine(url, pool_pre_ping=True, connect_args=_CONNECT)


def open_storage(address: StudyAddress) -> RDBStorage:
    """Optuna's tables on the server, made where there are none (the caller holds `advisory_lock`)."""
    options = {"pool_pre_ping": True, "connect_args": _CONNECT}
    logging.getLogger("optuna.storages._rdb.storage").setLevel(logging.ERROR)  # lost servers are reported below
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Optuna's migrations warn on a new database
        return RDBStorage(address.url, engine_kwargs=options)


@contextlib.contextmanager
def advisory_lock(engine: sqlalchemy.Engine) -> Iterator[None]:
    """Exclude other workers: two that make the same tables, or complete the same slot, would make each other fail."""
    with engine.begin() as connection:
        connection.execute(sqlalchemy.text("SELECT pg_advisory_xact_lock(:key)"), {"key": LOCK})
        yield


def is_unreachable(error: BaseException) -> bool:
    """Whether the error means that the server cannot be reached."""
    if isinstance(error, StorageInternalError | PendingRollbackError):  # Optuna continues on a lost connection
        cause = error.__cause__ or error.__context__
        return cause is not None and is_unreachable(cause)
    return isinstance(error, OperationalError | InterfaceError) or bool(getattr(error, "connection_invalidated", False))


def is_refusal(error: BaseException) -> bool:
    """Whether the server or its driver refuses the connection, so that waiting does not help."""
    state = getattr(_driver_error(error), "sqlstate", None)
    if state:
        return str(state).startswith(REFUSING_STATES)
    return any(word in str(error) for word in REFUSING_WORDS)


def _driver_error(error: BaseException) -> Any:
    """The error of the driver, inside those of SQLAlchemy and Optuna."""
    cause: Any = getattr(error, "orig", None) or error.__cause__ or error
    return getattr(cause, "orig", None) or cause


def retry_while_unreachable(
    action: Callable[[], R], address: StudyAddress, patience_s: float, note: str = ""
) -> Generator[str, None, R]:
    """Run `action`, repeatedly while the server is unreachable.

    Args:
        action: Uses the server.
        address: Of the server, for messages.
        patience_s: How long to try, s.
        note: Where unsaved data are; part of the messages.

    Yields:
        A message when the server becomes unreachable, and one when it answers again.

    Raises:
        BenchError: It was unreachable for `patience_s`.
        InputError: It refuses.
    """
    limit, wait_s, is_reported = time.monotonic() + patience_s, FIRST_WAIT_S, False
    while True:
        try:
            result = action()
            break
        except (StorageInternalError, SQLAlchemyError) as error:
            if is_refusal(error):
                raise _refusal(address, _reason(error)) from None
            if not is_unreachable(error):
                raise
            reason = _reason(error)
            if time.monotonic() + wait_s > limit:
                raise _no_answer(address, patience_s, reason, note) from None
        if not is_reported:
            message = f"{address.public} does not answer ({reason}); retrying for up to {patience_s:.0f} s"
            yield message + (f"; {note}" if note else "")
        is_reported = True
        time.sleep(wait_s)
        wait_s = min(2.0 * wait_s, LONGEST_WAIT_S)
    if is_reported:
        yield f"{address.public} answers again"
    return result


def _refusal(address: StudyAddress, reason: str) -> InputError:
    hint = "check user, database, options and password (PGPASSWORD or ~/.pgpass); may the user make tables?"
    return InputError(f"{address.public} refuses: {reason}", code="study_refused", key="--study", hint=hint)


def _no_answer(address: StudyAddress, patience_s: float, reason: str, note: str) -> BenchError:
    message = f"{address.public} does not answer" + (f", for {patience_s:.0f} s" if patience_s else "")
    message += f" ({reason})" + (f"; {note}" if note else "")
    hint = "start the server again, then the same command: it continues where it stopped"
    return BenchError(message, code="study_gone", key="--study", hint=hint)


def _reason(error: BaseException) -> str:
    cause = _driver_error(error)
    first_line = (str(cause).strip().splitlines() or [type(cause).__name__])[0]
    return first_line.rpartition("failed: ")[2].strip()  # 'connection to server at ... failed: Connection refused'
