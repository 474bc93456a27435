import pytest


@pytest.fixture(scope="module")
def uri(tmp_path_factory):
    return f"sqlite:///{tmp_path_factory.mktemp('store')}/mlflow.db"


@pytest.fixture(name="folder")
def _folder(tmp_path, monkeypatch):
    """The folder of the runs that a test starts, which do not say where theirs is."""
    monkeypatch.chdir(tmp_path)
    return tmp_path
