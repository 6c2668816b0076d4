"""Where a shared study is: PostgreSQL's address, what may be shown of it, and patience when it is gone (design D14)."""

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
    "client_encoding": "utf8",  # a database in SQL_ASCII gives bytes
    # a way that is cut in the middle of a question: libpq itself would wait for a quarter of an hour
    "tcp_user_timeout": 20_000,  # ms; the others in s
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 2,
}
FIRST_WAIT_S, LONGEST_WAIT_S = 0.5, 8.0
# SQLSTATE: who you are, which database, what you may do; where the driver has none (it does not connect), in words
REFUSING_STATES = ("28", "3D", "42501")
REFUSING_WORDS = (
    *("authentication failed", "does not exist", "no password", "permission denied", "pg_hba.conf"),
    *("invalid connection option", "invalid sslmode value"),
)
LOCK = 0x7F5E  # key of the advisory lock under which tables are made and slots are told

R = TypeVar("R")


class Address(NamedTuple):
    """url: for the driver, with the password. shown: for people, without. name: of the study in that database."""

    url: str
    shown: str
    name: str


def address_of(text: str) -> Address:
    """`postgresql://[USER[:PASSWORD]@]HOST[:PORT]/DATABASE[?OPTIONS][#STUDY]`, read.

    STUDY: the name of the study in that database, `tunefree` where it is left out. Raises InputError, which never says
    the password.
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
        found = f"{parts.scheme}://..." if parts.scheme else "no scheme"
        what = f"a shared study is in PostgreSQL; this is {found}, or names no database"
        raise InputError(what, code="bad_study", key="--study", hint=hint)
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
    url, shown = _spelled(plain, "postgresql+psycopg"), _spelled(bare, "postgresql")
    return Address(url, shown, parts.fragment or STUDY_NAME)


def _spelled(parts: SplitResult, scheme: str) -> str:
    """urlunsplit, which drops the slashes of an empty host (a socket is then in the options)."""
    text = urlunsplit(parts._replace(scheme=scheme))
    return text if "://" in text else text.replace(":", "://", 1)


def open_engine(address: Address) -> sqlalchemy.Engine:
    """Connections to the server; each is tested before it is used."""
    url = sqlalchemy.make_url(address.url)
    return sqlalchemy.create_engine(url, pool_pre_ping=True, connect_args=_CONNECT)


def open_storage(address: Address) -> RDBStorage:
    """Optuna's tables on that server, made where they are not there (the caller holds `one_at_a_time`)."""
    options = {"pool_pre_ping": True, "connect_args": _CONNECT}
    logging.getLogger("optuna.storages._rdb.storage").setLevel(logging.ERROR)  # a lost server is ours to tell of
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Optuna's own migrations are chatty on a fresh database
        return RDBStorage(address.url, engine_kwargs=options)


@contextlib.contextmanager
def one_at_a_time(engine: sqlalchemy.Engine) -> Iterator[None]:
    """Other workers wait: two that make the same tables, or tell the same slot, would fail each other."""
    with engine.begin() as connection:
        connection.execute(sqlalchemy.text("SELECT pg_advisory_xact_lock(:key)"), {"key": LOCK})
        yield


def is_gone(error: BaseException) -> bool:
    """Whether this says that the server, or the way to it, is not there."""
    if isinstance(error, StorageInternalError | PendingRollbackError):  # Optuna goes on asking on a lost connection
        cause = error.__cause__ or error.__context__
        return cause is not None and is_gone(cause)
    return isinstance(error, OperationalError | InterfaceError) or bool(getattr(error, "connection_invalidated", False))


def refused(error: BaseException) -> bool:
    """Whether the server, or its driver, is there and refuses us: waiting would not help."""
    state = getattr(_driver_error(error), "sqlstate", None)
    if state:
        return str(state).startswith(REFUSING_STATES)
    return any(word in str(error) for word in REFUSING_WORDS)


def _driver_error(error: BaseException) -> Any:
    """What the driver said, under what SQLAlchemy and Optuna put around it."""
    cause: Any = getattr(error, "orig", None) or error.__cause__ or error
    return getattr(cause, "orig", None) or cause


def patiently(work: Callable[[], R], address: Address, patience_s: float, kept: str = "") -> Generator[str, None, R]:
    """`work()`, again and again while the server is gone; yields a sentence when it is, and when it is back.

    Raises BenchError after patience_s, with `kept` (what is safe where) in it, and InputError when the server refuses.
    """
    limit, wait_s, said = time.monotonic() + patience_s, FIRST_WAIT_S, False
    while True:
        try:
            found = work()
            break
        except (StorageInternalError, SQLAlchemyError) as error:
            if refused(error):
                hint = "check user, database, options and password (PGPASSWORD or ~/.pgpass); may the user make tables?"
                raise InputError(
                    f"{address.shown} refuses: {_reason(error)}", code="study_refused", key="--study", hint=hint
                ) from None
            if not is_gone(error):
                raise
            if time.monotonic() + wait_s > limit:
                raise BenchError(
                    f"{address.shown} does not answer"
                    + (f", for {patience_s:.0f} s" if patience_s else "")
                    + f" ({_reason(error)})"
                    + (f"; {kept}" if kept else ""),
                    code="study_gone",
                    key="--study",
                    hint="start the server again, then the same command: it goes on where it was",
                ) from None
            reason = _reason(error)
        if not said:
            words = f"{address.shown} does not answer ({reason}); tried again for up to {patience_s:.0f} s"
            yield words + (f"; {kept}" if kept else "")
        said = True
        time.sleep(wait_s)
        wait_s = min(2.0 * wait_s, LONGEST_WAIT_S)
    if said:
        yield f"{address.shown} answers again"
    return found


def _reason(error: BaseException) -> str:
    cause = _driver_error(error)
    first = (str(cause).strip().splitlines() or [type(cause).__name__])[0]
    return first.rpartition("failed: ")[2].strip()  # 'connection to server at ... failed: Connection refused'
