"""Each landmark keeps the edge that a file, a map or `Tag.edges` gives to it. Takes a second."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from lmd.core.checks import InputError
from lmd.evaluation.mounting import read_measured
from lmd.formats.tag_maps import FileDeployment
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import GivenDeployment, RandomDeployment, UniformDeployment
from lmd.scene.footprints import Footprints, beside
from lmd.scene.tag import Tag
from lmd.space.cuboid import Cuboid

ROOM = Cuboid((6.0, 4.0, 2.8), (5.0, 3.0, 1.2), 0.5)
TAG = Tag(0.1)
FILE = """id,x,y,z,nx,ny,nz,edge,note
4,0,1,1,1,0,0,0.2,large
7,0,2,1,1,0,0,,as all
5,0,3,1,1,0,0,0.06,small
"""


@pytest.fixture
def path(tmp_path):
    (tmp_path / "tags.csv").write_text(FILE)
    return tmp_path / "tags.csv"


def test_a_file_says_the_edges_and_is_written_again(path, tmp_path):
    found = Deployment.from_csv(path)
    assert_array_equal(found.edges, [0.2, np.nan, 0.06])
    assert_array_equal(found.edges_of(TAG), [0.2, 0.1, 0.06])
    assert_array_equal(found.edges_of(Tag()), [0.0, 0.0, 0.0])
    assert list(found.labels.columns) == ["note"]
    found.to_csv(tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_text().splitlines()[:3] == [
        "id,x,y,z,nx,ny,nz,edge,note",
        "4,0.0,1.0,1.0,1.0,0.0,0.0,0.2,large",
        "7,0.0,2.0,1.0,1.0,0.0,0.0,,as all",
    ]
    assert_array_equal(Deployment.from_csv(tmp_path / "again.csv").edges, found.edges)
    assert not found[1:2].has_own_edges
    assert_array_equal((found + found[[2]]).edges, [0.2, np.nan, 0.06, 0.06])
    assert_array_equal((found[[1]] + found).edges, [np.nan, 0.2, np.nan, 0.06])


def test_placed_tags_have_the_edges_in_turn_and_those_of_a_file_their_own(path):
    several = replace(TAG, edges=(0.3, 0.05))
    footprints, rng = Footprints(ROOM, several), np.random.default_rng(0)
    for source in (RandomDeployment(5), UniformDeployment(5)):
        assert_array_equal(footprints.draw(source, rng).edges, [0.3, 0.05, 0.3, 0.05, 0.3])
    assert_array_equal(footprints.draw(FileDeployment(path), rng).edges_of(several), [0.2, 0.1, 0.06])
    given = Deployment.from_csv(path).with_surfaces(ROOM)
    assert_array_equal(footprints.draw(GivenDeployment(given), rng).edges, given.edges)
    assert not Footprints(ROOM, TAG).draw(RandomDeployment(5), rng).has_own_edges
    whole = footprints.draw(RandomDeployment(2), rng, fixed=footprints.checked_fixed(given, RandomDeployment(2)))
    assert_array_equal(whole.edges_of(several), [0.2, 0.1, 0.06, 0.3, 0.05])
    assert_array_equal(beside(given, given[[0]] + replace(given[[1]], labels=None)).edges_of(TAG)[:3], [0.2, 0.1, 0.06])


def test_a_paper_hangs_where_its_own_size_has_room(path):
    wall = FILE.replace("0,1,1,1,0,0,0.2", "0,0.06,1,1,0,0,{}")
    for edge, fits in ((0.08, True), (0.2, False)):
        path.write_text(wall.format(edge))
        if fits:  # nearer to the corner than a tag with the edge of all may be
            assert_allclose(Footprints(ROOM, TAG).draw(FileDeployment(path), None).edges[0], edge)
            continue
        with pytest.raises(InputError, match=r"landmark 4 has a paper 0\.25 m wide, which extends beyond x_min"):
            Footprints(ROOM, TAG).draw(FileDeployment(path), None)
    path.write_text(FILE.replace("0,2,1,1", "0,1.15,1,1"))
    with pytest.raises(InputError, match=r"overlap: their papers are 0\.125 and 0\.25 m wide, .* 0\.15 m apart"):
        Footprints(ROOM, TAG).draw(FileDeployment(path), None)


def test_a_measured_tag_without_a_size_has_that_of_its_plan(path, tmp_path):
    plan = Deployment.from_csv(path).with_surfaces(ROOM)
    measured = tmp_path / "measured.csv"
    measured.write_text(FILE.replace(",0.2,", ",,").replace(",0.06,", ",0.07,"))
    problem = type("Any", (), {"start": RandomDeployment(3), "scene": type("Of", (), {"room": ROOM, "tag": TAG})})
    problem.scene.footprints = Footprints(ROOM, TAG)
    assert_array_equal(read_measured(measured, problem, plan).edges_of(TAG), [0.2, 0.1, 0.07])
