"""Whatever else a test of a command is about, its tables are looked at."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _tables_fit(tables_fit: None) -> None:
    pass
