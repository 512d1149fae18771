from __future__ import annotations

import pytest
from filtering_sessions import OPTIONS


@pytest.fixture(autouse=True)
def _sessions_on_the_device(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(OPTIONS, "device", device)
