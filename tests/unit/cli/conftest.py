import pytest


@pytest.fixture(autouse=True)
def data(tmp_path, monkeypatch):
    """The folder of the user's files, which is empty; and no arm in the environment."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    for name in ("SO101_PORT", "SO101_MACHINE", "SO101_API_KEY", "SO101_API_KEY_ID"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path / "data" / "so101_motion"
