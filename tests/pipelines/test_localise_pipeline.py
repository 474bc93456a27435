"""`pipelines.localise` as a user meets it: files, text and messages."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation
from support import bags, processes, walks
from support import localisations as ld

from lmd.core.tables import write_table
from lmd.formats.detection_formats import write_detections
from lmd.formats.tag_maps import write_map_covariance
from lmd.formats.trajectories import TrajectoryFile
from lmd.geometry.camera import PIXEL_CENTRE
from lmd.localise.images import State
from lmd.scene.deployment import COLUMNS, UP_COLUMNS

FILES = {"poses.csv", "poses.tum", "changes.csv", "localise.json", "localise.png", ".hydra"}
FILES |= {"colmap", "transforms.json"}
GIVEN = ["detections=seen.csv", "camera.path=camera.yaml", "tracking=none"]
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A map with standard deviations, a calibration and the detections of a walk."""
    cwd, walk = tmp_path_factory.mktemp("work"), ld.walked(3)
    walks.calibration(cwd / "camera.yaml", walks.CAMERA)
    write_detections(cwd / "seen.csv", walk.detected)
    poses = walk.known.poses
    vectors = np.hstack([poses[:, :3, 3], poses[:, :3, 2], poses[:, :3, 1]])
    named = dict(zip((*COLUMNS, *UP_COLUMNS), vectors.T, strict=True))
    (cwd / "survey").mkdir()
    write_table(cwd / "survey" / "map.csv", {"id": walk.known.ids, **named, "edge": walk.known.edges})
    write_map_covariance(cwd / "survey" / "map.npz", walk.known.ids, poses[:, :3, 3], walk.known.joint)
    return cwd, walk


@pytest.fixture(scope="module")
def done(room):
    result = processes.inside("localise", "map=survey", "hydra.run.dir=out", cwd=room[0], settings=GIVEN)
    assert result.returncode == 0, result.stderr
    return room[0] / "out", result.stdout


def test_poses_are_written_with_their_covariances(done, room):
    out, text = done
    walk = room[1]
    assert {path.name for path in out.iterdir()} == FILES
    table = pd.read_csv(out / "poses.csv")
    assert table.time.tolist() == np.unique(walk.detected.frame).tolist()
    known = table.state == State.LOCALISED.value
    assert f"frames   {known.sum()} of {len(table)} localised" in text
    assert known.sum() > 55
    off = table.loc[known, ["x", "y", "z"]].to_numpy() - walk.frames[table.time[known], :3, 3]
    names = ["x", "y", "z"]
    square = [
        own @ np.linalg.solve(np.array([[row[f"cov_{min(a, b)}_{max(a, b)}"] for a in names] for b in names]), own)
        for own, (_, row) in zip(off, table[known].iterrows(), strict=True)
    ]
    assert 1.5 < np.mean(square) < 6.0  # three degrees of freedom, and errors of one map
    upper = [name for name in table if name.startswith("cov_")]
    assert upper[:3] == ["cov_x_x", "cov_x_y", "cov_x_z"]
    assert len(upper) == 21
    read = TrajectoryFile(str(out / "poses.tum")).trajectory
    np.testing.assert_allclose(read.poses[:, :3, 3], table.loc[known, names], atol=1e-8)
    refused = json.loads((out / "localise.json").read_text())["refused"]
    assert set(refused) == set(map(str, table.time[~known]))


def test_the_standard_deviations_of_the_map_count(done, room):
    """Without a covariance, those of the command count; large ones make poses less sure."""
    cwd = room[0]
    shutil.copy(cwd / "survey" / "map.csv", cwd / "plain.csv")
    rough = ["localise.place=0.02", "localise.turn=0.02", "hydra.run.dir=rough"]
    result = processes.inside("localise", "map=plain.csv", *rough, cwd=cwd, settings=GIVEN)
    assert result.returncode == 0, result.stderr
    sure, unsure = (pd.read_csv(folder / "poses.csv").cov_x_x.median() for folder in (done[0], cwd / "rough"))
    assert unsure > max(0.02**2 / 16, 4.0 * sure)  # images show where 16 tags are beside each other


def test_a_drive_is_smoothed_by_odometry(room):
    cwd, walk = room
    lines = ["time,x,y,z,qx,qy,qz,qw"]
    turns = Rotation.from_matrix(walk.frames[:, :3, :3]).as_quat()
    for k, (pose, turn) in enumerate(zip(walk.frames, turns, strict=True)):
        lines += [",".join(map(str, [k, *pose[:3, 3], *turn]))]
    (cwd / "odometry.csv").write_text("\n".join(lines))
    page = (processes.ROOT / "docs" / "clocks.md").read_text(encoding="utf-8")
    command = page.partition("pipelines.localise ")[2].partition("```")[0].replace("\\\n", " ")
    given = command.replace("outputs/surveyed", "survey").replace("outputs/localised", "smooth").split()
    result = processes.inside("localise", *given, cwd=cwd, settings=GIVEN)
    assert result.returncode == 0, result.stderr
    one, other = (pd.read_csv(cwd / "smooth" / name) for name in ("poses.csv", "smoothed.csv"))
    assert (other.state == "smoothed").sum() >= one.x.notna().sum()
    away = [np.linalg.norm(table[["x", "y", "z"]] - walk.frames[table.time, :3, 3], axis=1) for table in (one, other)]
    assert np.nanmedian(away[1]) < np.nanmedian(away[0])
    assert "\nsmoothed " in result.stdout
    said = json.loads((cwd / "smooth" / "localise.json").read_text())["clock"]
    assert said in result.stdout
    assert f"| `{said[:34]} ...` |" in page


def away(table, frames):
    """Distance of the localised images of a table from the true positions, metres."""
    known = table.state == State.LOCALISED.value
    return np.linalg.norm(table.loc[known, ["x", "y", "z"]].to_numpy() - frames[known, :3, 3], axis=1)


def test_a_rig_is_localised_by_a_bag_of_its_detections(room):
    """The second camera looks to the left of the first, whose poses are written."""
    cwd, walk = room
    left = np.array([[0.0, 0.0, -1.0, -0.1], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    mounts = np.stack([np.eye(4), left])
    seen = walks.photographed(walk.true, walk.frames, np.random.default_rng(5), ld.NOISE, mounts=mounts)
    rows = []
    for f in range(len(walk.frames)):
        for c, topic in enumerate(("/front", "/left")):
            own = np.flatnonzero((seen.frame == f) & (seen.camera == c))
            message = bags.tags(seen.ids[own], seen.corners[own] - PIXEL_CENTRE)
            rows.append((topic, "apriltag_msgs/msg/AprilTagDetectionArray", f * 10**9, message))
    bags.write(cwd / "rig.mcap", rows)
    own = "camera: {path: camera.yaml}"
    cameras = f"{{{own}}}, {{{own}, translation: [0, 0.1, 0], yaw: {np.pi / 2}}}"
    given = ["detections=rig.mcap", "topic=[/front,/left]", f"camera.rig=[{cameras}]", "tracking=none"]
    result = processes.inside("localise", "map=survey", "hydra.run.dir=rig", cwd=cwd, settings=given)
    assert result.returncode == 0, result.stderr
    table = pd.read_csv(cwd / "rig" / "poses.csv")
    off = away(table, walk.frames)
    assert len(off) > 50
    assert set(seen.camera) == {0, 1}
    assert np.median(off) < 0.005
