import pytest

from lmd.checkpoint import FILE, Checkpoint
from lmd.checks import InputError
from lmd.optimisers.ega import EGA

SETTINGS = {"seed": 0, "objective.n": 2}


def saved(directory, settings=SETTINGS):
    Checkpoint(EGA(seed=3), settings, "abc").save(directory)
    return directory


def test_a_checkpoint_comes_back_as_it_was(tmp_path):
    checkpoint = Checkpoint.load(saved(tmp_path), SETTINGS)
    assert (checkpoint.optimiser.seed, checkpoint.settings, checkpoint.run_id) == (3, SETTINGS, "abc")


def test_saving_leaves_one_file(tmp_path):
    saved(saved(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == [FILE]


def test_other_settings_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"was made with objective\.n = 2, not 3"):
        Checkpoint.load(saved(tmp_path), SETTINGS | {"objective.n": 3})
    with pytest.raises(InputError, match=r"was made with extra = None, not 1"):
        Checkpoint.load(tmp_path, SETTINGS | {"extra": 1})


def test_a_directory_without_a_checkpoint_is_named(tmp_path):
    with pytest.raises(InputError, match=rf"resume = '{tmp_path}' holds no {FILE}"):
        Checkpoint.load(tmp_path, SETTINGS)


@pytest.mark.parametrize("content", [b"", b"not a pickle", b"\x80\x04N."])
def test_a_damaged_checkpoint_is_named(tmp_path, content):
    (tmp_path / FILE).write_bytes(content)
    with pytest.raises(InputError, match=r"checkpoint\.pkl (cannot be read|is not a checkpoint)"):
        Checkpoint.load(tmp_path, SETTINGS)
