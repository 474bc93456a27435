"""Commands run no code from untrusted folders or tracking stores, and checking these imports nothing."""

import sys
from pathlib import Path

import pytest
from omegaconf import OmegaConf
from support import composing

import pipelines.report
from lmd.core.checks import InputError, printable
from pipelines.app import CONF
from pipelines.composing import FILES, GROUPS, _parts_of
from pipelines.trust import Trust

EVIL = """
import os
from dataclasses import dataclass
from pathlib import Path

Path("imported").touch()


@dataclass
class Room:
    size: float = 1.0
"""
# Each value refers ten times to the one before it.
GROWING = ", ".join(f"a{i}: '{f'${{room.a{i - 1}}}' * 10 if i else 'x'}'" for i in range(1, 11)) + ", a: 1"
LANDMARKS = "id,x,y,z,nx,ny,nz\n0,0,1,1,1,0,0\n1,0,2,1,1,0,0\n"


@pytest.fixture(scope="module")
def composed():
    """The default configuration of `optimise`, as Hydra writes it."""
    return OmegaConf.to_yaml(composing.composed("optimise"))


@pytest.fixture
def strangers(tmp_path, monkeypatch, composed):
    """A function that writes a run's folder with other settings, beside a module `evil` that leaves traces."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "evil.py").write_text(EVIL)
    folder = tmp_path / "run"
    (folder / ".hydra").mkdir(parents=True)
    (folder / "landmarks.csv").write_text(LANDMARKS)

    def write(changes="", text=None):
        config = OmegaConf.merge(OmegaConf.create(composed), OmegaConf.create(changes))
        (folder / ".hydra" / "config.yaml").write_text(OmegaConf.to_yaml(config) if text is None else text)
        return folder

    yield write
    sys.modules.pop("evil", None)


def told(*names, **trusted):
    """What `run=DIR` says of a run; empty where it takes the run."""
    try:
        _parts_of(Path("run"), "run", Trust(names, **trusted), GROUPS, FILES)
    except InputError as error:
        return f"error: {error}\n"
    return ""


TARGETS = {
    "room: {_target_: evil.Room}": "room._target_ = 'evil.Room' would run code",
    "room: {_target_: os.system}": "room._target_ = 'os.system'",
    "room: {relevance: {_target_: evil.Room}}": "room.relevance._target_ = 'evil.Room'",
    "camera: {rig: [{camera: {_target_: evil.Room, _partial_: true}}]}": "camera.rig.0.camera._target_",
    "objective: {_target_: lmd.formats.calibrations.yaml.load}": "lmd.formats.calibrations.yaml.load",  # a walk
    "objective: {_target_: lmd.core.tables.write_table}": "objective._target_ = 'lmd.core.tables.write_table'",
    "pdf: {_target_: lmd.geometry.camera.Camera}": "pdf._target_ = 'lmd.geometry.camera.Camera'",  # of another group
    "pdf: {_target_: '${optimiser._target_}'}": "pdf._target_ must name a class or a function",
    "pdf: {_target_: evil}": "pdf._target_ must name",
    "'room': {'a\\e[2J': {_target_: os.system}}": "error: run: ",
}
TEXTS = {
    "visibility: {thold: '${oc.env:SECRET}'}": "visibility.thold = '${oc.env:SECRET}' would call a resolver",
    "room: {size: ['${now:%Y}']}": "room.size.0 = '${now:%Y}'",
    "tag: {family: '${oc.select:${oc.env:SECRET}}'}": "tag.family",
    "tag: {family: '${tag.edge}${oc.env:SECRET}'}": "would call a resolver",
    "tag: {family: '${ hydra : searchpath }'}": "would call a resolver",
}


@pytest.mark.parametrize("changes", TARGETS | TEXTS)
def test_a_run_of_a_stranger_runs_no_code(strangers, monkeypatch, changes):
    monkeypatch.setenv("SECRET", "sesame")
    strangers(changes)
    error = told()
    assert (TARGETS | TEXTS)[changes] in error
    assert error.startswith("error: run: 'run/.hydra/config.yaml': ")
    assert error.count("\n") == 1
    assert printable(error.strip()) == error.strip()
    assert "sesame" not in error
    assert "evil" not in sys.modules
    assert not Path("imported").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        # Hydra would put the room where its callbacks are: it imports and calls them.
        (
            "room: {hydra: {callbacks: {a: 1}}}\nobjective: {defaults: [{/room@_global_: run}]}",
            "objective must be a mapping without a key 'defaults'",
        ),
        ("room: [1]", "room must be a mapping without a key 'defaults'"),
        ("room: &a [*a]", "its YAML aliases expand to inf values, more than its 13 characters"),
        ("room: {size: &a [1], walls: *a}", "room.walls is a YAML alias"),
        ("room: {_target_: [[lmd]]}", "room._target_ must name"),
        ("room: {? [1, 2] : 3}", "cannot be read"),
        ("room: {? !!binary aGk= : 3}", "room has a key that is not a text"),
        ("tag: {family: '${oc.${tag.edge}env:SECRET}'}", "would call a resolver"),
        ("tag: {family: '${tag[edge}'}", "tag.family = '${tag[edge}' would call a resolver"),
        ("room: {size: !!timestamp 2020-01-01}", "room.size must be a number, a text"),
        (f"room: {{{GROWING}}}", "room.a2 refers to a value that is itself a reference"),
        (f"room: {{a: {'b' * 60_000}, c: '{'${room.a}' * 20}'}}", "has 1260"),
        (
            "room: {x: {a: '${...tag.x}', b: '${tag.x}'}}\ntag: {x: '${room.x}'}",
            "refers to a value that is itself a reference",
        ),
        ("room: {_recursive_: false}", "room._recursive_: remove the key _recursive_, which no option of room has"),
        ("room: {low: [{_args_: [1]}]}", "room.low.0._args_.0: remove the key _args_, which no option of room has"),
        ("room: !!python/object/apply:os.system [touch imported]", "cannot be read"),
        ("room: {size: " + "[" * 2_000, "cannot be read"),
        ("- 1", "is not a configuration"),
    ],
)
def test_what_hydra_has_not_written_is_refused(strangers, text, message):
    strangers(text=text)
    error = told()
    assert message in error
    assert error.count("\n") == 1
    assert not Path("imported").exists()


def test_aliases_do_not_grow(strangers):
    """The deepest list has ten to the power of thirty entries."""
    levels = [f"- &l{i} [{', '.join([f'*l{i - 1}'] * 10) if i else 0}]" for i in range(30)]
    strangers(text="other:\n" + "\n".join(levels) + "\nroom: {size: *l29}")
    assert "alias" in told()


def test_a_run_without_code_of_others_is_taken(strangers):
    strangers("visibility: {_target_: lmd.sight.models.fiducial.Fiducial, tag: '${tag}', detector: '${tag.family}'}")
    assert told() == ""


def test_a_group_may_name_what_its_nested_groups_name(strangers):
    moving = "{_target_: lmd.estimation.flights.RandomMotion, duration: 1.0}"
    strangers(f"objective: {{trajectory: {moving}}}")
    assert told() == ""
    strangers(f"visibility: {{trajectory: {moving}}}")
    assert "would run code" in told()


@pytest.mark.parametrize("names", [["evil"], ["evil.Room", "os"]])
def test_a_package_that_is_trusted_may_be_named_but_not_walked_through(strangers, names):
    strangers("room: {_target_: evil.Room}")
    assert told(*names) == ""
    assert "evil" in sys.modules
    strangers("room: {_target_: evil.os.getcwd}")
    assert "room._target_ = 'evil.os.getcwd' is only imported by code that you trust" in told("evil")


def test_what_files_of_ones_own_search_path_name_is_trusted(strangers):
    folder = strangers("room: {_target_: evil.Room}")
    own = folder.parent / "mine"
    (own / "room").mkdir(parents=True)
    (own / "room" / "hall.yaml").write_text("_target_: evil.Room  # mine\n")
    places = [("hydra", "pkg", "hydra.conf"), ("main", "file", CONF), ("command-line", "file", str(own))]
    sources = [dict(zip(("provider", "schema", "path"), place, strict=True)) for place in places]
    given = Trust.of(OmegaConf.create({}), OmegaConf.create({"config_sources": sources}))
    assert (given.names, given.folders) == ((), (Path(CONF), own))
    assert told(folders=given.folders) == ""
    assert "evil" not in sys.modules  # it needs no look: the name is that of the file
    strangers("objective: {_target_: evil.Room}")
    assert "add trust=[evil]" in told(folders=given.folders)
    assert composing.composed("export", "run=run", "trust=[evil]", f"hydra.searchpath=[{own}]").run == "run"


@pytest.mark.parametrize("value", ["[1]", "evil"])
def test_trust_is_a_list_of_names(strangers, value):
    strangers()
    with pytest.raises(InputError, match=r"^trust must be a list of names, got "):
        composing.composed("export", f"trust={value}")


class Reader:
    """A store with one run."""

    def __init__(self, folder):
        self.folder = folder

    def artifact(self, run_id, name):
        return self.folder / (f".hydra/{name}" if name.endswith("yaml") else name)


@pytest.mark.parametrize("changes", ["room: {_target_: evil.Room}", "room: {spacing: '${oc.env:SECRET}'}"])
def test_a_report_builds_nothing_that_a_store_names(strangers, changes):
    reader = Reader(strangers(changes))
    with pytest.raises(InputError, match=r"^run 3f: config\.yaml: room\..* would (run code|call a resolver)"):
        pipelines.report._load(reader, "3f", Trust())
    assert "evil" not in sys.modules
    strangers("objective: {n: '${seed.of}'}")
    with pytest.raises(InputError, match=r"^run 3f: config\.yaml: "):
        pipelines.report._load(reader, "3f", Trust())
    strangers("optimiser: {_target_: evil.Room}\ntracking: {_target_: evil.Room}\nthreads: '${oc.env:SECRET}'")
    assert pipelines.report._load(reader, "3f", Trust())[0].count == 2  # which needs none of these
    assert "evil" not in sys.modules
