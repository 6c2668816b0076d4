"""Truths under seal: a commitment (SHA-256 over nonce and text) that anybody may read, and the text under a key stream.

The key stream keeps a truth from being met by accident (a search through the folder, an open editor); the commitment
shows that it was not changed. A truth is opened only where its answer is there.
"""

from __future__ import annotations

import hashlib
import json
from typing import Any

from tools.gap_exam.files import Run, read_json, write_json


class Broken(Exception):
    """A seal that does not hold what it promised."""


class StillSealed(Exception):
    """A truth that may not be opened yet."""


def commitment(text: str, nonce: str) -> str:
    """What is promised before the answer."""
    return hashlib.sha256(f"{nonce}\0{text}".encode()).hexdigest()


def _stream(text: bytes, nonce: str) -> bytes:
    key = b""
    while len(key) < len(text):
        key += hashlib.sha256(f"{nonce}\0key\0{len(key)}".encode()).digest()
    return bytes(a ^ b for a, b in zip(text, key, strict=False))


def seal(truth: Any, nonce: str) -> dict[str, str]:
    """A truth's sealed form. nonce: 32 hex digits that nobody can guess."""
    text = json.dumps(truth, sort_keys=True, allow_nan=False)
    return {"commitment": commitment(text, nonce), "nonce": nonce, "sealed": _stream(text.encode(), nonce).hex()}


def unseal(sealed: dict[str, str]) -> Any:
    """The truth; raises Broken where it is not what was promised."""
    try:
        text = _stream(bytes.fromhex(sealed["sealed"]), sealed["nonce"]).decode()
    except (UnicodeDecodeError, ValueError) as error:
        raise Broken("the sealed text cannot be read") from error
    if commitment(text, sealed["nonce"]) != sealed["commitment"]:
        raise Broken("the truth is not the one that was sealed")
    return json.loads(text)


def put_away(run: Run, number: int, truth: Any, nonce: str) -> str:
    """Seal a case's truth beside it; its commitment. A truth that is sealed already stays as it is."""
    path = run.sealed(number)
    if not path.is_file():
        write_json(path, seal(truth, nonce))
    return read_json(path)["commitment"]


def open_truth(run: Run, number: int) -> Any:
    """The truth of an answered case. Raises StillSealed before there is an answer."""
    if not run.is_answered(number):
        raise StillSealed(f"case {number} has no answer yet: its truth stays sealed")
    return unseal(read_json(run.sealed(number)))
