"""Checkpoints come back as they were, or are refused; reading one runs no code."""

import os
import pickle
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from lmd.checkpoint import CHECKSUM, FILE, HEADER, Checkpoint
from lmd.checks import InputError
from lmd.optimisers.ega import EGA
from lmd.optimisers.random_search import RandomSearch

SETTINGS = {"seed": 0, "objective.n": 2}


def saved(directory, settings=SETTINGS):
    Checkpoint(EGA(seed=3), settings, "abc").save(directory)
    return directory


def resumed(directory, settings=SETTINGS, optimiser=None):
    checkpoint = Checkpoint(optimiser or EGA(), settings)
    checkpoint.resume(directory)
    return checkpoint


def written(directory, content):
    """A checkpoint with a proper checksum, whatever it holds."""
    (directory / FILE).write_bytes(HEADER + CHECKSUM(content).digest() + content)
    return directory


def test_a_checkpoint_comes_back_as_it_was(tmp_path):
    checkpoint = resumed(saved(tmp_path))
    assert (checkpoint.optimiser.seed, checkpoint.settings, checkpoint.run_id) == (3, SETTINGS, "abc")


def test_saving_leaves_one_file(tmp_path):
    saved(saved(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == [FILE]


def test_other_settings_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"was made with objective\.n = 2, not 3"):
        resumed(saved(tmp_path), SETTINGS | {"objective.n": 3})
    with pytest.raises(InputError, match=r"was made with extra = None, not 1"):
        resumed(tmp_path, SETTINGS | {"extra": 1})


def test_a_directory_without_a_checkpoint_is_named(tmp_path):
    with pytest.raises(InputError, match=rf"resume = '{tmp_path}' holds no {FILE}"):
        resumed(tmp_path)


@pytest.mark.parametrize("content", [b"", b"not a pickle", b"\x80\x04N."])
def test_what_is_no_checkpoint_is_named(tmp_path, content):
    (tmp_path / FILE).write_bytes(content)
    with pytest.raises(InputError, match=r"checkpoint\.pkl is not a checkpoint of this version"):
        resumed(tmp_path)
    with pytest.raises(InputError, match=r"checkpoint\.pkl cannot be read"):
        resumed(written(tmp_path, content))


def test_every_flipped_bit_is_noticed(tmp_path):
    path = saved(tmp_path) / FILE
    content = path.read_bytes()
    for place in range(len(content)):
        path.write_bytes(content[:place] + bytes([content[place] ^ 1 << place % 8]) + content[place + 1 :])
        with pytest.raises(InputError, match=r"checkpoint\.pkl is (damaged|not a checkpoint)"):
            resumed(tmp_path)


def test_a_checkpoint_that_is_cut_short_is_damaged(tmp_path):
    path = saved(tmp_path) / FILE
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(InputError, match=r"checkpoint\.pkl is damaged"):
        resumed(tmp_path)


class Call:
    """Pickled, it is a call."""

    def __init__(self, function, *arguments):
        self.function, self.arguments = function, arguments

    def __reduce__(self):
        return self.function, self.arguments


@pytest.mark.parametrize("function", [os.system, eval, getattr, Path, np.memmap, OrderedDict])
def test_a_checkpoint_calls_nothing(tmp_path, function):
    content = pickle.dumps(({"seed": Call(function, "touch never")}, SETTINGS, None))
    with pytest.raises(InputError, match=r"cannot be read \(UnpicklingError: it names .* which is neither numpy's nor"):
        resumed(written(tmp_path, content))


@pytest.mark.parametrize(
    ("module", "name"),
    [
        ("lmd.checkpoint", "os.system"),  # reached through a module of ours
        ("lmd.checkpoint", "Path"),  # imported there
        ("lmd.optional", "optional"),  # ours, and no class
        ("numpy", "load"),
        ("numpy.testing", "rundocs"),
    ],
)
def test_nothing_but_classes_of_ours_is_named(tmp_path, module, name):
    content = b"\x80\x04" + b"".join(b"\x8c" + bytes([len(text)]) + text.encode() for text in (module, name)) + b"\x93."
    with pytest.raises(InputError, match=rf"UnpicklingError: it names {module}\.{name}"):
        resumed(written(tmp_path, content))


@dataclass
class Memory:
    seen: np.ndarray


class Remembering(RandomSearch):
    """An optimiser of another package, with a class of its own in its state."""

    def __init__(self, seed=0):
        super().__init__(10, seed=seed)
        self.memory = Memory(np.arange(3.0))


def test_classes_of_the_package_of_the_optimiser_are_read(tmp_path):
    optimiser = Remembering(seed=2)
    optimiser.rng = np.random.default_rng(5)
    optimiser.memory.seen += 1.0
    Checkpoint(optimiser, SETTINGS).save(tmp_path)
    again = resumed(tmp_path, optimiser=Remembering()).optimiser
    assert again.memory.seen.tolist() == [1.0, 2.0, 3.0]
    assert again.rng.random() == np.random.default_rng(5).random()
    with pytest.raises(InputError, match=rf"it names {__name__}\.Memory"):
        resumed(tmp_path, optimiser=RandomSearch(10))


@pytest.mark.parametrize("kind", ["MT19937", "PCG64", "PCG64DXSM", "Philox", "SFC64"])
def test_every_generator_of_numpy_is_read(tmp_path, kind):
    optimiser = EGA()
    optimiser.rng = np.random.Generator(getattr(np.random, kind)(1))
    Checkpoint(optimiser, SETTINGS).save(tmp_path)
    assert resumed(tmp_path).optimiser.rng.random() == optimiser.rng.random()
