"""Ids and further columns of a file with landmarks come out as they went in."""

import numpy as np
import pytest
from support.paper import paper_room
from support.small import make, problem

from lmd.core.checks import InputError
from lmd.detection.frames import tagged_room
from lmd.formats.tag_maps import FileDeployment
from lmd.optimisers.ledger import Budget
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.labels import Labels
from lmd.scene.tag import Tag

FILE = """# of the lab
id,x,y,z,note,nx,ny,nz
7,0,1,1,by the door,1,0,0
3,0,2,1,,1,0,0
9,7.5,2,1,"shelf, #2",-1,0,0
"""


@pytest.fixture
def path(write):
    return write(FILE)


def test_ids_and_columns_are_read_and_written(path, tmp_path):
    drawn = FileDeployment(path).draw(paper_room(), np.random.default_rng(0))
    assert drawn.ids.tolist() == [7, 3, 9]
    drawn.to_csv(tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_text().splitlines() == [
        "id,x,y,z,nx,ny,nz,note",
        "7,0.0,1.0,1.0,1.0,0.0,0.0,by the door",
        "3,0.0,2.0,1.0,1.0,0.0,0.0,",
        '9,7.5,2.0,1.0,-1.0,0.0,0.0,"shelf, #2"',
    ]
    again = Deployment.from_csv(tmp_path / "again.csv")
    assert again.labels.columns == drawn.labels.columns
    again.to_csv(tmp_path / "tags.csv", ups=True)
    assert (tmp_path / "tags.csv").read_text().startswith("id,x,y,z,nx,ny,nz,ux,uy,uz,note\n7,")
    assert Deployment.from_csv(tmp_path / "tags.csv").labels.columns == drawn.labels.columns


def test_a_selection_keeps_its_labels_and_a_sum_is_numbered_anew(path):
    deployment = Deployment.from_csv(path)
    some = deployment[np.array([2, 0])]
    assert some.ids.tolist() == [9, 7]
    assert some.labels.columns == {"note": ["shelf, #2", "by the door"]}
    assert deployment[1:].ids.tolist() == [3, 9]
    assert (deployment + some).ids.tolist() == list(range(5))


def test_without_ids_landmarks_are_numbered_from_zero(write):
    assert Deployment.from_csv(write("x,y,z,nx,ny,nz\n1,0,1,0,1,0\n2,0,1,0,1,0\n")).ids.tolist() == [0, 1]
    assert RandomDeployment(3).draw(paper_room(), np.random.default_rng(0)).ids.tolist() == [0, 1, 2]


@pytest.mark.parametrize("name", ["annealing", "ega", "greedy"])
def test_optimisers_move_landmarks_and_leave_their_labels(path, name):
    start = FileDeployment(path)
    result = make(name).run(problem(start), Budget(20))
    assert result.deployment.ids.tolist() == [7, 3, 9]
    assert result.deployment.labels.columns == {"note": ["by the door", "", "shelf, #2"]}


def test_a_tag_has_the_number_of_its_landmark(path):
    deployment = Deployment.from_csv(path)
    assert tagged_room(paper_room(), deployment, Tag(0.1)).ids.tolist() == [7, 3, 9]
    with pytest.raises(InputError, match=r"^family 16h5 has the tags 0 to 29, but a landmark has the id 40\.$"):
        Tag(0.1, "16h5").check_ids(np.array([2, 40]))


def test_as_many_ids_as_landmarks():
    with pytest.raises(InputError, match="a deployment has 2 positions but 1 ids"):
        Deployment(np.zeros((2, 3)), np.tile([1.0, 0.0, 0.0], (2, 1)), labels=Labels(np.array([4])))
