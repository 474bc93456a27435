"""Messages name the key that was given, and what it was meant to be."""

import sys

import pytest
from composing import composed
from meshes import captured
from numpy.random import default_rng
from omegaconf import OmegaConf

from lmd.core.checks import InputError
from pipelines.building import build_problem
from pipelines.landmarks import fixed_of
from pipelines.nodes import instantiate
from pipelines.overrides import ask_what_was_meant, meant


def test_a_key_that_is_like_another_one_is_asked_about(monkeypatch, capsys):
    given = ["room.keepout=[]", "room.keep_out=[]", "deployment.count=5", "nothing.like=it", "+room.mine=1", "--help"]
    monkeypatch.setattr(sys, "argv", ["optimise", *given])
    ask_what_was_meant()
    assert capsys.readouterr().err == "room.keepout: did you mean room.keep_out?\n"
    assert meant("budget.evaluation") == "did you mean budget.evaluations?"
    assert meant("room") == ""


def test_so_is_one_of_a_file_of_ones_own():
    room = composed("optimise", "room=floor_plan").room
    OmegaConf.set_struct(room, False)
    room.keepout = []
    with pytest.raises(InputError, match=r"^room\.keepout is no setting .*; did you mean room\.keep_out\?$"):
        instantiate(room)


def test_a_file_of_fixed_landmarks_is_named_by_its_key():
    with pytest.raises(InputError, match=r"^fixed: there is no file 'none\.csv'\.$"):
        fixed_of(OmegaConf.create({"fixed": "none.csv"}), "36h11")


def test_the_axis_of_a_mesh_that_was_given_is_warned_of(tmp_path, capsys):
    path = captured(tmp_path / "room.obj", default_rng(1))
    warned = []
    for up in ("z", "y"):
        cfg = composed("optimise", "room=mesh", f"room.path={path}", f"room.up={up}", "room.spacing=1")
        build_problem(cfg)
        warned.append(f"warning: room.up: is it right for '{path}'? With y up it is " in capsys.readouterr().err)
    assert warned == [False, True]


OWN = """
class Mine:
    def __init__(self, width=1, seed=0):
        if width > 1:
            raise KeyError("wide")
"""
GA = "pymoo.algorithms.soo.nonconvex.ga"


@pytest.mark.parametrize(
    ("target", "given", "message"),
    [
        (f"{GA}.GAA", {}, f"part._target_ = '{GA}.GAA': {GA} has no GAA; did you mean GA?"),
        ("pymoo.algorithms.soo.nonconvx.GA", {}, ": pymoo.algorithms.soo has no nonconvx; did you mean nonconvex?"),
        ("lmd.objectives.coverage.Covrage", {}, ": lmd.objectives.coverage has no Covrage; did you mean Coverage?"),
        ("nevergrad.optimizers.CMAA", {}, ": nevergrad.optimizers has no CMAA; did you mean CMA"),
        ("own_modul.Mine", {}, ": there is no module own_modul; did you mean own_module?"),
        ("own_module.Other", {}, ": own_module has no Other; it has Mine"),
        ("own_failing.Mine", {}, ": own_failing.Mine cannot be imported: ZeroDivisionError: division by zero ("),
        ("own_lacking.Mine", {}, ": ModuleNotFoundError: No module named 'lmd.nothing' (own_lacking.py, line 1)"),
        ("own_module.Mine", {"widht": 2}, "part.widht is no setting that is known; did you mean part.width?"),
        ("own_module.Mine", {"step": 2}, "part.step is no setting that is known; own_module.Mine takes width"),
        ("pipelines.operations.tracking.tracker.NoTracker", {}, "part: NoTracker"),  # Python words it in two ways
        ("own_module.Mine", {"width": 2}, "part: own_module.Mine failed: KeyError: 'wide' (own_module.py, line 5)"),
        ("lmd.optimisers.ledger.Ledger", {}, "part: lmd.optimisers.ledger.Ledger must take the argument seed."),
        ("lmd.optimisers.wrapped.AskAndTell", {}, "part: AskAndTell.__init__() missing 1 required"),
    ],
)
def test_a_misspelt_class_or_argument_is_told_what_there_is(target, given, message, tmp_path, monkeypatch):
    for name, text in (("module", OWN), ("failing", "1 / 0"), ("lacking", "import lmd.nothing")):
        (tmp_path / f"own_{name}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError) as told:
        instantiate(OmegaConf.create({"part": {"_target_": target, **given}}).part, seed=0)
    assert message in str(told.value)
    assert str(told.value).startswith("part")
