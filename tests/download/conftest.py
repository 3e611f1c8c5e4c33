from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.download import server


@pytest.fixture(autouse=True)
def _no_proxy(monkeypatch: pytest.MonkeyPatch) -> None:
    """A proxy that this machine may have would not find a server of this machine."""
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")


@pytest.fixture
def site() -> Iterator[server.Site]:
    with server.running() as site:
        yield site
