"""python-can, imported without its MF4 reader.

python-can imports asammdf (and by it pandas) wherever the extra `mf4` is installed: 70 MB and 0.3 s more for every
process that opens a bus, when only `bus/formats/mf4.py` reads such files, and by asammdf itself. A module of this
package that wants python-can takes it from here; dbc.py, whose cantools imports python-can, keeps asammdf out likewise.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def absent(package: str) -> Iterator[None]:
    """Let `package` look as if it were not installed, unless it is imported already; afterwards it is itself again."""
    if package in sys.modules:
        yield
        return
    sys.modules[package] = None  # type: ignore[assignment]  # Python's own sign for "cannot be imported"
    try:
        yield
    finally:
        del sys.modules[package]


with absent("asammdf"):
    import can

__all__ = ["absent", "can"]
