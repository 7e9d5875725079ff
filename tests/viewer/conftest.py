"""What tests of pages share."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator

import pytest
from browser import Chromium


@pytest.fixture(scope="session")
def chromium() -> Iterator[Chromium]:
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        browser = Chromium(profile)
        yield browser
        browser.close()
