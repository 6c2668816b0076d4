"""drives.jsonl: the chunks of a road sweep, appended as they are finished; readable after a kill at any moment."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.jobs.robustness.driving.chunk import DriveRow, FinishedChunk, chunk_from_data
from tunefree_hil.jobs.run_folder import write_text

SCHEMA = "tunefree.robustness_drives/1"


class DriveFile:
    """The finished chunks of a plan. chunks: By number, as read and appended."""

    def __init__(self, path: Path, key: str) -> None:
        """Open the file of a plan, or make it; a line that was cut off is removed.

        Raises:
            InputError: It belongs to another plan.
        """
        self._path = path
        self.chunks: dict[int, list[DriveRow]] = {}
        if path.is_file():
            self._read(key)
        else:
            write_text(path, json.dumps({"schema": SCHEMA, "key": key}) + "\n")

    def append(self, chunk: FinishedChunk) -> None:
        """Append a chunk, which is then on the disk; one that is there already is left out."""
        if chunk.number in self.chunks:
            return
        try:
            with self._path.open("ab") as file:
                file.write((json.dumps(chunk.as_data(), allow_nan=False) + "\n").encode())
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            hint = "free some space or check the permissions, then run the same command"
            message = f"cannot write: {error.strerror}"
            raise BenchError(message, code="disk", file=str(self._path), hint=hint) from error
        self.chunks[chunk.number] = chunk.rows

    def list_rows(self) -> list[DriveRow]:
        """All drives, in the order of the plan."""
        return [row for number in sorted(self.chunks) for row in self.chunks[number]]

    def _read(self, key: str) -> None:
        content = self._path.read_bytes()
        whole = 0
        for number, line in enumerate(content.splitlines(keepends=True) or [b""]):
            data = _parse(line)
            if number == 0:
                self._require_same(data, key)
            elif data is None:
                break
            else:
                chunk = chunk_from_data(data)
                self.chunks[chunk.number] = chunk.rows
            whole += len(line)
        if whole < len(content):
            os.truncate(self._path, whole)

    def _require_same(self, head: dict[str, Any] | None, key: str) -> None:
        if head is None or head.get("schema") != SCHEMA or head.get("key") != key:
            raise InputError(
                "holds the drives of another sweep: gains, roads, cars, model or files differ",
                code="changed",
                file=str(self._path),
                key="--out",
                hint="give another folder with --out, or delete this one",
            )


def _parse(line: bytes) -> dict[str, Any] | None:
    """A line of JSON; None for one that was cut off."""
    if not line.endswith(b"\n"):
        return None
    try:
        data = json.loads(line)
    except ValueError:
        return None
    return data if isinstance(data, dict) else None
