"""Models of COLMAP, nerfstudio and trajectories: what is written is read by others, and what is read is aligned."""

import json
import re
import shlex
import sys
from dataclasses import replace

import numpy as np
import pytest
from support import localisations as ld
from support import processes, walks

from lmd.adjust.tables import files_of_model
from lmd.core.checks import InputError
from lmd.formats.pose_files import tum_text
from lmd.formats.reconstructions import Model, model_files, read_model
from lmd.geometry.camera import Camera
from lmd.geometry.projection import project
from lmd.geometry.se3 import exp, pose_of
from lmd.localise.alignment import align
from lmd.localise.localise import Drive, localise
from lmd.scene.tag import Tag

sys.path.append(str(processes.ROOT / "benchmarks"))
import metric_frames

SCALE, SIGMAS = 1.7, np.repeat([0.002, 0.003], 3)  # errors of models: rad and metres
LENSES = {"PINHOLE": (), "OPENCV": (-0.1, 0.02, 1e-3, -2e-3), "FULL_OPENCV": (-0.1, 0.02, 1e-3, -2e-3, 0.01)}
LENSES |= {"OPENCV_FISHEYE": (0.02, -0.01, 3e-3, 1e-3), "": (0.1, 0.2, 1e-3, 2e-3, 0.1, 0.3, 0.1, 0.05)}


def written(folder, files):
    """The files of a model in a folder."""
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content if isinstance(content, str) else json.dumps(content))
    return folder


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A walk, its localisation, and a folder with the files of this localisation."""
    walk = ld.walked(4)
    result = ld.localised(walk, calibrate=False)
    files, _ = files_of_model(result.found, result.detected, [walks.CAMERA])
    return walk, result, written(tmp_path_factory.mktemp("model"), files)


def shrunk(frames, rng, names, sigmas=SIGMAS, wrong=()):
    """Model of images, of which some are wrong, in another frame whose unit is 1.7 m."""
    poses = exp(rng.normal(size=6)) @ frames @ exp(rng.normal(size=(len(frames), 6)) * sigmas)
    poses[list(wrong)] = poses[list(wrong)] @ exp(rng.normal(size=(len(wrong), 6)))
    return Model(names, pose_of(poses[:, :3, :3], poses[:, :3, 3] / SCALE), lambda _: {})


def off_scale(figures):
    """Error of a scale in its standard deviations."""
    return (figures["scale"] - SCALE) / figures["scale_sigma"]


NAMES = [f"some/folder/{k}.png" for k in range(60)]


def test_scales_are_within_their_deviations_and_wrong_images_are_named(done):
    for seed in range(8):
        rng = np.random.default_rng(seed)
        wrong = rng.choice(60, 6, replace=False)
        files, figures, _ = align(shrunk(done[0].frames, rng, NAMES, wrong=wrong), done[1])
        assert abs(off_scale(figures)) < 3.0
        named, images = set(files["alignment.json"]["astray"]), files["alignment.csv"]["image"].tolist()
        assert {f"{k}.png" for k in wrong} & set(images) <= named
        assert len(named) < 10


@pytest.mark.thorough("lmd/localise", "lmd/adjust")
def test_errors_of_the_map_and_of_the_camera_count():
    """The model is nearly exact, so the errors that all images share are most of the error. Half a minute."""
    off = []
    for seed in range(40):
        walk = ld.walked(seed, frames=30, place=0.003, turn=0.003)
        model = shrunk(walk.frames, np.random.default_rng(seed), NAMES[:30], SIGMAS / 20.0)
        off.append(off_scale(align(model, ld.localised(walk, calibrate=seed % 2 == 0))[1]))
    assert (np.abs(off) < 3.0).mean() >= 0.95
    assert 0.5 < np.std(off) < 1.3


def test_pycolmap_sees_the_tags_where_they_were_detected_and_nerfstudio_too(done):
    """pycolmap projects to COLMAP's pixels, which `lmd` has too. OpenGL's camera looks along -z, and y points up."""
    colmap = pytest.importorskip("pycolmap").Reconstruction(str(done[2] / "colmap"))
    document, some = json.loads((done[2] / "transforms.json").read_text()), done[1].found.sightings
    matrices = {frame["file_path"]: np.array(frame["transform_matrix"]) for frame in document["frames"]}
    images = {image.name: image for image in colmap.images.values()}
    for k in np.flatnonzero(done[1].found.used)[::7]:
        name = f"{some.frame[k]}.png"
        places = [colmap.points3D[int(4 * some.tag[k] + c + 1)].xyz for c in range(4)]
        x, y, z, _ = np.linalg.solve(matrices[name], np.column_stack([places, np.ones(4)]).T)
        by_hand = [document["cx"] - document["fl_x"] * x / z, document["cy"] + document["fl_y"] * y / z]
        for corners in ([images[name].project_point(place) for place in places], np.transpose(by_hand)):
            np.testing.assert_allclose(corners, some.image[k], atol=2.0)
            assert np.abs(np.mean(corners - some.image[k])) < 0.3


def test_a_model_comes_back_and_moves_as_pycolmap_moves_it(done, tmp_path):
    _, result, model = done
    pycolmap = pytest.importorskip("pycolmap")
    assert align(read_model(model / "colmap"), result)[1]["scale"] == pytest.approx(1.0, abs=1e-6)
    to = exp(np.array([0.3, -1.0, 2.0, 4.0, 5.0, -6.0])) @ np.diag([SCALE, SCALE, SCALE, 1.0])
    ours = pycolmap.Reconstruction(str(written(tmp_path / "ours", read_model(model / "colmap").moved(to))))
    theirs = pycolmap.Reconstruction(str(model / "colmap"))
    theirs.transform(pycolmap.Sim3d(to[:3]))
    for k, image in theirs.images.items():
        np.testing.assert_allclose(ours.images[k].cam_from_world().matrix(), image.cam_from_world().matrix(), atol=1e-9)
    for k, point in theirs.points3D.items():
        np.testing.assert_allclose(ours.points3D[k].xyz, point.xyz, atol=1e-9)
    theirs.write_binary(str(tmp_path))
    assert align(read_model(tmp_path), result)[1]["scale"] == pytest.approx(1.0 / SCALE, abs=1e-6)
    (tmp_path / "moved.json").write_text(json.dumps(read_model(model / "transforms.json").moved(to)["transforms.json"]))
    again = align(read_model(tmp_path / "moved.json"), result)[0]["alignment.json"]
    np.testing.assert_allclose(again["similarity"] @ to, np.eye(4), atol=1e-6)


@pytest.mark.parametrize("name", LENSES)
def test_lenses_are_those_of_colmap(name):
    kind = {"OPENCV_FISHEYE": "equidistant", "": "rational_polynomial"}.get(name, "plumb_bob")
    camera = Camera(4.0, 0.008, 0.0081, (330.0, 250.0), 640, 480, 0.0, distortion=LENSES[name], distortion_model=kind)
    files, note = model_files([camera], [], np.zeros(0, dtype=int), np.empty((0, 4, 4)), np.empty((0, 3)))
    assert bool(note) == ("transforms.json" not in files) == (not name)
    _, model, *size = files["colmap/cameras.txt"].split()
    assert [model, *size[:2]] == [name or "FULL_OPENCV", "640", "480"]
    values = list(map(float, size[2:]))
    theirs = pytest.importorskip("pycolmap").Camera(model=model, width=640, height=480, params=values)
    points = np.random.default_rng(0).uniform([-0.4, -0.3, 1.0], [0.4, 0.3, 1.2], (20, 3))
    np.testing.assert_allclose(theirs.img_from_cam(points), project(camera, np.eye(4), points), atol=1e-9)


def test_a_rig_is_aligned_by_folder_and_name_and_a_trajectory_by_time(tmp_path):
    walk, rng = ld.walked(4, frames=24), np.random.default_rng(1)
    left = np.array([[0.0, 0.0, -1.0, -0.1], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    mounts, cameras, times = np.stack([np.eye(4), left]), [walks.CAMERA] * 2, [f"{k}.50" for k in range(24)]
    seen = walks.photographed(walk.true, walk.frames, rng, ld.NOISE, mounts=mounts)
    seen, errors = replace(seen, cameras=("front", "/left"), times=tuple(times)), walks.constant_errors(ld.NOISE)
    found = localise(seen, cameras, Tag(walks.EDGE), errors, walk.known, Drive(mounts, steady=False), calibrate=False)
    names = [f"images/{camera}/{time}.png" for time in times for camera in ("front", "left")]
    model = shrunk((walk.frames[:, None] @ mounts).reshape(-1, 4, 4), rng, names)
    (tmp_path / "path.tum").write_text(tum_text(np.arange(24) + 0.507, model.poses[::2]))
    for other, least in ((model, 35), (read_model(tmp_path / "path.tum"), 20)):
        files, figures, _ = align(other, found)
        assert abs(off_scale(figures)) < 3.0
        assert figures["aligned"] > least
    assert files["aligned/model.tum"].count("\n") == 25


def test_models_that_do_not_fit_are_refused(done):
    one = shrunk(done[0].frames, np.random.default_rng(0), NAMES)
    turned = one._replace(poses=one.poses @ exp(np.array([1.5, 0.7, 0.0, 0.0, 0.0, 0.0])))
    still = one._replace(poses=np.where(np.arange(4) == 3, one.poses[:1], one.poses))
    for model in (one._replace(names=["b.png"] * 60), turned, still):
        with pytest.raises(InputError, match=r"^align: .* (0 localised images in both|fit one similarity)"):
            align(model, done[1])


@pytest.mark.parametrize(
    ("images", "message"), [("#\n", "no image"), ("1 2 0 0 0 0 0 0 1 a.png\n\n", "line 1: the quat")]
)
def test_text_that_is_no_model_is_refused(images, message, tmp_path):
    written(tmp_path, {"cameras.txt": "", "images.txt": images, "points3D.txt": ""})
    with pytest.raises(InputError, match=f"^align: .*images.txt.*{message}"):
        read_model(tmp_path)


@pytest.mark.thorough("docs/metric_frames.md", "lmd/localise", "lmd/formats/reconstructions.py", "pipelines")
def test_the_commands_of_the_page_do_what_it_says(tmp_path):
    page, rng = (processes.ROOT / "docs" / "metric_frames.md").read_text(encoding="utf-8"), np.random.default_rng(1)
    tags, frames = walks.spaced_tags(16, rng), walks.walk(30, rng)
    walks.calibration(tmp_path / "camera.yaml", metric_frames.CAMERA)
    walks.photograph(tmp_path / "photos", tags, np.arange(16), frames, metric_frames.CAMERA, metric_frames.EDGE)
    wrong = metric_frames.colmap(tmp_path / "sparse" / "0", frames, rng)
    for line in re.search(r"```sh\n(.*?)```", page, re.S)[1].replace("\\\n", "").splitlines():
        _, _, module, *words = shlex.split(line)
        done = processes.inside(module.removeprefix("pipelines."), *words, cwd=tmp_path, settings=["tracking=none"])
        assert done.returncode == 0, done.stderr
    told = re.findall(r"^\| `([\w./]+)` \|", page.partition("| file |")[2], re.M)
    assert [(tmp_path / "outputs" / "metric" / name).exists() for name in told] == [True] * 4
    document = json.loads((tmp_path / "outputs" / "metric" / "alignment.json").read_text())
    assert {int(name[:4]) for name in document["astray"]} == wrong
    assert abs(off_scale(document["figures"])) < 3.0
