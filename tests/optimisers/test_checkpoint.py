"""Checkpoints come back as they were, or are refused; reading one runs no code."""

import io
import json
import math
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.small import BUDGET, SETTINGS, problem, resumed, saved, stopped
from support.thorough import examples

from lmd.core.checks import InputError
from lmd.objectives.coverage import Coverage
from lmd.objectives.sampling import Sampling
from lmd.optimisers.annealing import Annealing
from lmd.optimisers.checkpoint import CHECKPOINT_FILE, DOCUMENT_KEY, Checkpoint
from lmd.optimisers.genetic import EGA
from lmd.optimisers.ledger import Budget
from lmd.optimisers.stored import generator, generator_state
from lmd.problem import Problem
from lmd.scene.deployment_sources import UniformDeployment

REFUSED = r"checkpoint\.npz(:| is damaged, or is not a checkpoint of this version| cannot be resumed| was made with)"
# Optimisers and where they are stopped: what an annealing keeps depends on its stage.
STAGES = {"genes": (EGA, 60), "stacks": (Annealing, 30), "single": (Annealing, 60), "walk": (Annealing, 70),
          "ascent": (Annealing, 90)}  # fmt: skip


def robust():
    """A problem that annealing climbs on samples, from a start that is given."""
    p = problem(UniformDeployment(30))
    return Problem(p.scene, Coverage(2, 0.15, Sampling(positions=2, divisions=6)), p.start, threads=1)


@pytest.fixture(scope="module", name="problems")
def _problems():
    return {"plain": problem(), "robust": robust()}


@pytest.fixture(name="small")
def _small(problems):
    return problems["plain"]


@pytest.fixture(scope="module", name="case", params=STAGES)
def _case(request, problems, tmp_path_factory):
    """What makes an optimiser, its problem, a folder with its checkpoint, and what the archive holds."""
    make, evaluations = STAGES[request.param]
    p = problems["robust" if request.param in ("walk", "ascent") else "plain"]
    folder = tmp_path_factory.mktemp(request.param)
    Checkpoint(stopped(make(), p, evaluations), SETTINGS, "abc").save(folder)
    with np.load(folder / CHECKPOINT_FILE, allow_pickle=False) as archive:
        return make, p, folder, dict(archive)


def written(directory, members):
    """A checkpoint with these members."""
    np.savez(directory / CHECKPOINT_FILE, **members)
    return directory


def changed(members, change):
    """The members with another document."""
    document = json.loads(bytes(members[DOCUMENT_KEY]))
    change(document)
    return members | {DOCUMENT_KEY: np.frombuffer(json.dumps(document).encode(), np.uint8)}


def is_harmless(directory, make, p):
    """Return whether a checkpoint is refused in a sentence, or resumed within the budget."""
    try:
        optimiser = resumed(directory, p, optimiser=make()).optimiser
    except InputError as error:
        text = str(error)
        return text.isprintable() and len(text) < 500 + len(str(directory)) and CHECKPOINT_FILE in text
    before = optimiser.ledger.evaluations
    return optimiser.run(p, Budget(BUDGET)).evaluations <= max(BUDGET, before)


def test_a_checkpoint_comes_back_as_it_was(case, tmp_path):
    make, p, folder, members = case
    checkpoint = resumed(folder, p, optimiser=make())
    assert (checkpoint.settings, checkpoint.run_id) == (SETTINGS, "abc")
    checkpoint.save(tmp_path)
    with np.load(tmp_path / CHECKPOINT_FILE) as again:
        assert {key: again[key].tobytes() for key in again} == {key: members[key].tobytes() for key in members}


def test_a_run_that_goes_on_ends_as_if_it_had_not_been_stopped(case):
    make, p, folder, _ = case
    whole = make().run(p, Budget(BUDGET))
    parts = resumed(folder, p, optimiser=make()).optimiser.run(p, Budget(BUDGET))
    for part in ("positions", "normals", "surfaces"):
        np.testing.assert_array_equal(getattr(parts.deployment, part), getattr(whole.deployment, part))
    assert [r.best_fitness for r in parts.history] == [r.best_fitness for r in whole.history]
    assert [repr(r.evaluations) for r in parts.history] == [repr(r.evaluations) for r in whole.history]


def test_saving_leaves_one_file_and_what_cannot_be_written_the_one_before(tmp_path, small, monkeypatch):
    before = (saved(saved(tmp_path, small), small) / CHECKPOINT_FILE).read_bytes()
    monkeypatch.setattr("os.fsync", lambda _: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(OSError, match="No space left"):
        saved(tmp_path, small)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {CHECKPOINT_FILE: before}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"objective.n": 3}, r"was made with objective\.n = 2, not 3"),
        ({"extra": 1}, r"was made with extra = None, not 1"),
    ],
)
def test_other_settings_are_refused(settings, message, tmp_path, small):
    with pytest.raises(InputError, match=rf"resume = '{tmp_path}' holds no {CHECKPOINT_FILE}"):
        resumed(tmp_path, small)
    with pytest.raises(InputError, match=message):
        resumed(saved(tmp_path, small), small, SETTINGS | settings)


def test_of_a_batch_cut_short_by_the_budget_a_larger_one_goes_on(tmp_path, small):
    optimiser = EGA()
    optimiser.run(small, Budget(BUDGET))  # 30 + 3 x 22 + 4
    Checkpoint(optimiser, SETTINGS).save(tmp_path)
    again = resumed(tmp_path, small).optimiser
    more, same = again.run(small, Budget(BUDGET + 50)), optimiser.run(small, Budget(BUDGET + 50))
    assert more.evaluations == BUDGET + 50
    np.testing.assert_array_equal(more.deployment.positions, same.deployment.positions)


# What an attacker hands over.


class Call:
    """Pickled, it is a call."""

    def __init__(self, function, *arguments):
        self.function, self.arguments = function, arguments

    def __reduce__(self):
        return self.function, self.arguments


def test_a_pickle_is_not_read_alone_or_within_the_archive(case, tmp_path):
    (make, p, _, members), call = case, Call(Path.touch, tmp_path / "ran")
    (tmp_path / CHECKPOINT_FILE).write_bytes(pickle.dumps(({"seed": call}, SETTINGS, None)))
    with pytest.raises(InputError, match=REFUSED):
        resumed(tmp_path, p, optimiser=make())
    for key in members:
        array = np.array([call], dtype=object)
        with pytest.raises(InputError, match=r"ValueError: Object arrays cannot be loaded"):
            resumed(written(tmp_path, members | {key: array}), p, optimiser=make())
    assert not (tmp_path / "ran").exists()


KINDS = [np.uint8, np.int64, np.float64, np.complex128, "M8[s]", "S3", ">f8"]
VALUES = [0, 1, -1, 2**31, 2**62, math.nan, math.inf, -math.inf, 1e300, -1e300, 0.5]
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=4,
)


@examples(60)
@given(st.data())
def test_a_tampered_array_is_refused_or_harmless(case, tmp_path_factory, data):
    make, p, _, members = case
    key = data.draw(st.sampled_from(sorted(members)))
    array, how = members[key].copy(), data.draw(st.sampled_from(["value", "kind", "shape", "none"]))
    if how == "value":
        with np.errstate(all="ignore"):
            value = np.array(data.draw(st.sampled_from(VALUES))).astype(array.dtype)
        array.reshape(-1)[data.draw(st.integers(0, max(array.size - 1, 0))) if array.size else slice(0)] = value
    elif how == "kind":
        array = np.zeros(array.shape, data.draw(st.sampled_from(KINDS)))
    elif how == "shape":
        array = np.resize(array, data.draw(st.lists(st.integers(0, 40), max_size=3)))
    tampered = {k: v for k, v in members.items() if k != key} | ({} if how == "none" else {key: array})
    assert is_harmless(written(tmp_path_factory.getbasetemp(), tampered), make, p)


@examples(60)
@given(st.data())
def test_a_tampered_document_is_refused_or_harmless(case, tmp_path_factory, data):
    make, p, _, members = case

    def change(document):
        place = document
        while True:
            key = data.draw(st.sampled_from(sorted(place)))
            if not isinstance(place[key], dict) or not place[key] or data.draw(st.booleans()):
                break
            place = place[key]
        if data.draw(st.booleans()):
            place[key] = data.draw(JSON)
        else:
            del place[key]

    assert is_harmless(written(tmp_path_factory.getbasetemp(), changed(members, change)), make, p)


@pytest.mark.parametrize("case", ["stacks", "walk"], indirect=True)
@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("here.surfaces", 2**40, r"here\.surfaces must not have the value 1099511627776"),
        ("best.surfaces", -1, r"best\.surfaces must not have the value -1"),
        ("here.positions", 1e6, r"here\.positions must not have the value 1000000"),
        ("best.normals", 0.9, r"landmark 29: the normal must have length 1"),
        ("evaluations", math.nan, r"evaluations must not have the value nan"),
        ("best_fitness", math.inf, r"best_fitness must not have the value inf"),
        ("wall_time", -1.0, r"wall_time must not have the value -1"),
        ("evaluations", 1.0, r"the best fitness must not fall"),
    ],
)
def test_what_kernels_would_trust_is_checked(case, tmp_path, key, value, message):
    make, p, _, members = case
    array = members[f"state.{key}"].copy()
    array[-1] = value
    with pytest.raises(InputError, match=rf"checkpoint\.npz: {message}"):
        resumed(written(tmp_path, members | {f"state.{key}": array}), p, optimiser=make())


def test_a_generator_is_no_way_to_memory():
    state = generator_state(np.random.default_rng(5))
    assert generator("rng", state).random() == np.random.default_rng(5).random()
    for change in ({"has_uint32": 2}, {"uinteger": 2**40}, {"state": {"state": 2**130, "inc": 1}}, {"state": {}}):
        with pytest.raises((InputError, ValueError, KeyError)):
            generator("rng", state | change)
    with pytest.raises(InputError, match=r"only generators of numpy\.random\.default_rng can be saved, not a MT19937"):
        generator_state(np.random.Generator(np.random.MT19937(1)))


def archived(path, members, compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, content in members:
            archive.writestr(name, content)


def claiming(shape):
    """An array of a few bytes that claims to be large."""
    content = io.BytesIO()
    np.lib.format.write_array_header_1_0(content, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return content.getvalue() + bytes(64)


def deep(levels):
    content = io.BytesIO()
    np.save(content, np.frombuffer(b"[" * levels, np.uint8))
    return content.getvalue()


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize(
    "craft",
    [
        lambda path: archived(path, [("a.npy", bytes(10**7))], zipfile.ZIP_DEFLATED),
        lambda path: archived(path, [("document.npy", claiming((2**40,)))]),
        lambda path: archived(path, [("document.npy", claiming((2**33, 2**33)))]),
        lambda path: archived(path, [("document.npy", deep(10**5))]),
        lambda path: archived(path, [("document", b"{}")]),
        lambda path: archived(path, [("../document.npy", b"{}"), ("\x1b[31m.npy", b"")]),
        lambda path: np.savez(path, **{DOCUMENT_KEY: np.frombuffer(b'{"$array": "none"}', np.uint8)}),
        lambda path: np.savez(path, **{DOCUMENT_KEY: np.array(7)}),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(bytes(range(256)) * 40),
    ],
)  # fmt: skip
def test_a_crafted_archive_is_refused(craft, tmp_path, small):
    craft(tmp_path / CHECKPOINT_FILE)
    with pytest.raises(
        InputError, match=r"checkpoint\.npz is damaged, or is not a checkpoint of this version"
    ) as refused:
        resumed(tmp_path, small)
    assert str(refused.value).isprintable()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"\x1b[31mseed": 1}, r"a setting has an invalid name"),
        ({"seed": "\x1b[31m"}, r"was made with seed = '\\x1b\[31m', not 0"),
        ({"seed": {"$array": "state.told"}}, r"checkpoint\.npz"),
    ],
)
def test_settings_that_are_none_are_refused_in_printable_words(settings, message, case, tmp_path):
    make, p, _, members = case
    tampered = changed(members, lambda document: document["settings"].update(settings))
    with pytest.raises(InputError, match=message) as refused:
        resumed(written(tmp_path, tampered), p, optimiser=make())
    assert str(refused.value).isprintable()
