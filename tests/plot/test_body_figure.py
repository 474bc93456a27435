import math

from matplotlib.image import imread
from support.paper import paper_camera

from lmd.cameras.body import Body
from lmd.plot.body_drawing import save_body_figure
from lmd.scene.rig import Mount, Rig

BODY = Body([{"low": [-0.4, -0.3, 0.0], "high": [0.4, 0.3, 0.5]}])


def drawn(path, *mounts):
    save_body_figure(path, BODY, Rig(mounts), "cameras")
    return imread(path)[..., :3]


def test_a_body_is_drawn_with_its_cameras(tmp_path):
    front, left = Mount(paper_camera(), (0.42, 0.0, 0.3)), Mount(paper_camera(), (0.0, 0.32, 0.3), yaw=math.pi / 2)
    one, other = drawn(tmp_path / "one.png", front), drawn(tmp_path / "other.png", left)
    assert one.shape == other.shape
    assert min((image < 0.5).any(axis=-1).sum() for image in (one, other)) > 5000
    assert (one != other).any(axis=-1).sum() > 1000
    assert drawn(tmp_path / "both.png", front, left).shape[0] > one.shape[0]
