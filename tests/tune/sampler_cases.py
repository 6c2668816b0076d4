"""The samplers as cases of a test: those of the extra `learn` are slow, and left out where it is not installed."""

from __future__ import annotations

from typing import Any

import pytest

from tunefree_hil.tune.sampling import RECORDS
from tunefree_hil.tune.sampling.records import SamplerRecord, is_installed

INSTALLED = [record.name for record in RECORDS if is_installed(record)]
FAST = [record.name for record in RECORDS if not record.module]


def case_from_record(record: SamplerRecord) -> Any:
    absent = pytest.mark.skipif(not is_installed(record), reason="the extra `learn` is not installed")
    return pytest.param(record.name, marks=[pytest.mark.slow, absent] if record.module else [])


CASES = [case_from_record(record) for record in RECORDS]
