"""A helper process that does what the tests of base/pipes.py ask of it: (what, with what)."""

from __future__ import annotations

import os
import sys
import time
from typing import Any

from tunefree_hil.base.pipes import send, serve


def main() -> None:
    """Serve until the input ends."""
    todo, answers = serve()
    while True:
        what, value = todo.get()
        for answer in answers_to(what, value):
            send(answers, answer)


def answers_to(what: str, value: Any) -> list[Any]:
    """No request, 'count' apart, has more than one answer."""
    if what == "variable":
        return [os.environ.get(value)]
    if what == "count":
        return list(range(value))
    if what == "print":
        print(value)
    elif what == "sleep":
        time.sleep(value)
    elif what == "end":
        sys.stderr.write(value)
        sys.stderr.flush()
        os._exit(3)
    return [value]


if __name__ == "__main__":
    main()
