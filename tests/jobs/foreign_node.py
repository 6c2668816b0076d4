"""A controller that is not ours, with faults: `foreign_node.py MODE`, started by a bench as its controller's command.

nameless: says HELLO without parameters. late: falls silent at tick AT, for longer than anybody waits. crash, leaves:
ends there with status 5, with status 0. A number: says FAILED with that error there, and goes on answering. Until then
each tick is answered with no command at all.
"""

from __future__ import annotations

import os
import sys
import time
from typing import Any

from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.link import BusLink
from tunefree_hil.bus.open import LinkRequest, open_link, resolve_bus
from tunefree_hil.bus.recording.frame_attribution import digest

AT = 20
FAR_S = 60.0


def main(mode: str) -> None:
    """Answer the bench channel until the hub is gone, or the mode says otherwise."""
    choice = resolve_bus("tfhub", os.environ["TUNEFREE_SESSION"])
    vehicle = open_link(choice, "vehicle", LinkRequest(name="controller"))
    bench = open_link(choice, "bench", LinkRequest(name="controller"))
    names = [] if mode == "nameless" else ["mine.gain"]
    _say(bench, *bc.hello_messages(bc.Role.CONTROLLER, "mine", names))
    left = -1
    while True:
        vehicle.receive(0.0)
        for frame in bench.receive(1.0):
            message = bc.decode(frame)
            if isinstance(message, bc.Hello) and message.role == bc.Role.RUNNER and message.part == 0:
                _say(bench, *bc.hello_messages(bc.Role.CONTROLLER, "mine", names))
            elif isinstance(message, bc.Episode):
                left = -1
            elif isinstance(message, bc.Param):
                left = (message.count if left < 0 else left) - 1
                if left == 0:
                    _say(bench, bc.Status(bc.Role.CONTROLLER, bc.State.READY, 0, 0))
            elif isinstance(message, bc.Done) and message.phase == 0:
                if message.k == AT:
                    _fail(mode)
                    if mode.isdigit():
                        _say(bench, bc.Status(bc.Role.CONTROLLER, bc.State.FAILED, int(mode), AT))
                _say(bench, bc.Done(message.k, 1, 0, digest([])))


def _fail(mode: str) -> None:
    if mode == "late":
        time.sleep(FAR_S)
    if mode in ("crash", "leaves"):
        print("the gain table is empty" if mode == "crash" else "enough for today", file=sys.stderr, flush=True)
        os._exit(5 if mode == "crash" else 0)


def _say(bench: BusLink, *messages: Any) -> None:
    bench.send([bc.encode(message) for message in messages])


if __name__ == "__main__":
    main(sys.argv[1])
