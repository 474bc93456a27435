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
