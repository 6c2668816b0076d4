"""Requests of the owner of a hub: logs and counts. Requests and replies are JSON (records.REQUEST, REPLY)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tunefree_hil.base.errors import BenchError
from tunefree_hil.bus.tfhub.records import CHANNELS, REPLY, RecordError, pack_control
from tunefree_hil.bus.tfhub.server.log import close_logs, open_logs
from tunefree_hil.bus.tfhub.server.sender_check import SenderCheck

if TYPE_CHECKING:
    from tunefree_hil.bus.tfhub.server.hub import Hub


def answer(hub: Hub, body: dict[str, Any]) -> bytes:
    """The REPLY to one request: {"ok": ...} or {"error": ...}. RecordError for an unknown request."""
    operations = {"start_log": _start_log, "stop_log": _stop_log, "stats": _stats, "guard": _guard}
    operation = operations.get(str(body.get("op")))
    if operation is None:
        raise RecordError(f"it asked for {body.get('op')!r}")
    try:
        return pack_control(REPLY, {"ok": operation(hub, body)})
    except BenchError as error:
        return pack_control(REPLY, {"error": error.as_dict()})


def _start_log(hub: Hub, body: dict[str, Any]) -> dict[str, Any]:
    if hub.logs:
        raise BenchError("a log is being written already", code="log_runs", hint="stop it first")
    paths = body.get("paths")
    if not isinstance(paths, dict) or not paths or not set(paths) <= set(CHANNELS):
        raise RecordError("it asked for a log without channels")
    hub.logs = open_logs(paths, hub.log_names, hub.epoch_offset_ns)
    return {}


def _stop_log(hub: Hub, body: dict[str, Any]) -> dict[str, int]:
    """Frames by channel."""
    if not hub.logs:
        raise BenchError("no log is being written", code="no_log", hint="start_log comes first")
    logs, hub.logs = hub.logs, {}
    close_logs(logs.values())
    return {channel: log.frames for channel, log in logs.items()}


def _guard(hub: Hub, body: dict[str, Any]) -> list[dict[str, Any]]:
    """With "ids": watch these from now on, and forget earlier counts. Without: the counts of foreign senders since."""
    if "ids" in body:
        ids = body["ids"]
        if not isinstance(ids, list) or not all(isinstance(can_id, int) for can_id in ids):
            raise RecordError("it asked to watch what are no ids")
        hub.sender_check = SenderCheck(frozenset(ids))
    return hub.sender_check.seen()


def _stats(hub: Hub, body: dict[str, Any]) -> dict[str, Any]:
    peers = [
        {
            "name": peer.name,
            "channel": peer.channel,
            "role": peer.role,
            "pid": peer.pid,
            "sent": peer.sent,
            "dropped": peer.dropped,
        }
        for peer in hub.board.peers
        if peer.role
    ]
    return {
        "frames": hub.frames,
        "peers": peers,
        "lost": list(hub.lost)[-20:],
        "held_by": [peer.name for blockers in hub.board.blockers.values() for peer in blockers],
    }
