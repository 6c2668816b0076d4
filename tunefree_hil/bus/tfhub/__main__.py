"""`python -m tunefree_hil.bus.tfhub --session NAME`: one hub in this process."""

from __future__ import annotations

import argparse
import sys

from tunefree_hil.base.errors import TunefreeError
from tunefree_hil.bus.tfhub.address import DEFAULT_TRANSPORT, HubInfo
from tunefree_hil.bus.tfhub.records import LOG_NAMES
from tunefree_hil.bus.tfhub.server.connections import OBSERVER_BYTES
from tunefree_hil.bus.tfhub.server.hub import HubOptions
from tunefree_hil.bus.tfhub.server.serve import announce, say_on_stderr, serve


def main() -> int:
    """Parse the command line and serve; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tunefree_hil.bus.tfhub", description=__doc__)
    parser.add_argument("--session", default="default", help="a name, or a directory of mode 0700")
    parser.add_argument("--tcp", action="store_true", help="loopback TCP with a token, instead of unix sockets")
    parser.add_argument(
        "--clock",
        choices=("real", "sender"),
        default="real",
        help="source of the time stamps: the hub (real), or lockstep members (sender)",
    )
    parser.add_argument(
        "--standalone", "--no-owner", action="store_true", help="live until SIGINT, not until the owner goes"
    )
    parser.add_argument("--vehicle-log-name", default=LOG_NAMES["vehicle"], help="channel name in the vehicle's log")
    parser.add_argument("--bench-log-name", default=LOG_NAMES["bench"], help="channel name in the bench's log")
    parser.add_argument("--observer-kib", type=int, default=OBSERVER_BYTES >> 10, help="what an observer may be owed")
    parser.add_argument("--say-ready", action="store_true", help="write a line to stdout when it listens")
    given = parser.parse_args()
    options = HubOptions(
        transport="tcp" if given.tcp else DEFAULT_TRANSPORT,
        clock=given.clock,
        standalone=given.standalone,
        log_names={"vehicle": given.vehicle_log_name, "bench": given.bench_log_name},
        observer_bytes=given.observer_kib << 10,
    )
    try:
        why = serve(given.session, options, ready=_say_ready if given.say_ready else announce)
    except TunefreeError as error:
        say_on_stderr(str(error))
        return error.exit_status
    if given.standalone:
        say_on_stderr(f"{given.session} ends: {why}")
    return 0


def _say_ready(_: HubInfo) -> None:
    sys.stdout.write("ready\n")  # whatever started this hub waits for it
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
