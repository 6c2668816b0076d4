"""The control connection of a hub's owner: starts and stops logs, reads the counts; the hub ends when it closes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from os import PathLike, fspath
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import BenchError, NoAnswer
from tunefree_hil.bus.tfhub import address
from tunefree_hil.bus.tfhub.records import REPLY, REQUEST, body_of, pack_control
from tunefree_hil.bus.tfhub.server.connection import Connection, ConnectionGone

REPLY_S = 60.0  # a disk may be slow; a hub that is gone is noticed at once
STATS_S = 5.0  # these need no disk: a hub that does not answer is stopped


class PeerStats(NamedTuple):
    """One peer of a hub. `dropped`: frames that an observer did not get."""

    name: str
    channel: str
    role: str
    pid: int
    sent: int
    dropped: int


class HubStats(NamedTuple):
    """`frames`: channel -> frames routed. `lost`: the latest losses. `held_by`: members for which the bus waits."""

    frames: dict[str, int]
    peers: tuple[PeerStats, ...] = ()
    lost: tuple[str, ...] = ()
    held_by: tuple[str, ...] = ()


class ForeignSender(NamedTuple):
    """A member that is no node of the bench and has sent a vehicle's id (SocketCAN's, EFF bit included)."""

    name: str
    pid: int
    can_id: int
    count: int


class Owner:
    """Open it soon after the hub was started: a hub (unless standalone) ends without one.

    `session`: as given to the hub. Every method raises BenchError when the hub is gone, and names it.
    """

    def __init__(self, session: str, *, name: str = "") -> None:
        info = address.read_hub(session)
        where = address.parse(info.addresses["bench"], info.token_file)
        self._connection = Connection(where, {"role": "owner"}, name)
        self.pid = self._connection.welcome.pid  # of the hub

    def start_log(self, paths: Mapping[str, str | PathLike[str]]) -> None:
        """Record channels from now on: {"vehicle": path, "bench": path}. Each file has its name only after stop_log."""
        whole = {channel: str(Path(fspath(path)).absolute()) for channel, path in paths.items()}
        self._ask({"op": "start_log", "paths": whole})

    def stop_log(self) -> dict[str, int]:
        """Finish the logs; frames by channel. BenchError names the file that could not be written."""
        return self._ask({"op": "stop_log"})

    def stats(self) -> HubStats:
        """The hub's numbers."""
        answer = self._ask({"op": "stats"})
        peers = tuple(PeerStats(**peer) for peer in answer["peers"])
        return HubStats(answer["frames"], peers, tuple(answer["lost"]), tuple(answer["held_by"]))

    def guard(self, ids: Iterable[int]) -> None:
        """From now on count frames with these ids (EFF bit included) on the vehicle channel that no node has sent."""
        self._ask({"op": "guard", "ids": sorted(ids)})

    def foreign_senders(self) -> list[ForeignSender]:
        """Senders of the guarded ids since `guard` that are no nodes: one entry a member and id."""
        return [ForeignSender(**one) for one in self._ask({"op": "guard"})]

    def close(self) -> None:
        """Give the hub up; it ends, unless it is standalone."""
        self._connection.close()

    def __enter__(self) -> Owner:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _ask(self, request: dict[str, Any]) -> Any:
        connection = self._connection
        try:
            connection.send(pack_control(REQUEST, request), REPLY_S)
            patience_s = STATS_S if request["op"] in ("stats", "guard") else REPLY_S
            if not connection.fill(patience_s):
                words = f"the {connection} did not answer {request['op']} within {patience_s:g} s"
                raise NoAnswer(words, code="no_answer")
            kind, record = connection.kind(), connection.take()
        except ConnectionGone as error:
            raise BenchError(f"the {connection} is gone: {error}", code="hub_gone") from None
        body = body_of(record)
        if kind != REPLY:
            why = body.get("message") or body.get("why")
            raise BenchError(f"the {connection} is gone: {why}", code="hub_gone")
        if "error" in body:
            raise BenchError(**body["error"])
        return body["ok"]
