"""Poses of images in files of COLMAP and nerfstudio, and in trajectories: reading, transforming and writing.

The camera frame of COLMAP and of lmd is x right, y down, z ahead, and that of nerfstudio (OpenGL) is x right, y up, z
back. COLMAP's poses are from the world to the camera, the other poses from the camera to the world. All three programs
count pixels from the outer corner of the first pixel, whose centre is (0.5, 0.5). A similarity X = s R x + p, with the
scale s, the rotation R and the shift p, is a matrix [s R, p; 0 1], `(4, 4)`.

Sources: COLMAP's "Output Format" and "Camera Models"; nerfstudio's "Data conventions".
"""

import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import FloatArray, InputError, IntArray, said_of
from lmd.core.optional import optional
from lmd.core.tables import is_number
from lmd.formats.detections import DetectedTags
from lmd.formats.pose_files import read_rows, tum_text
from lmd.formats.trees import File
from lmd.geometry.camera import Camera
from lmd.geometry.lens import EQUIDISTANT
from lmd.geometry.lens_models import BrownConrady, Equidistant
from lmd.geometry.se3 import act, are_rotations, inverse, pose_of, pose_rows, poses_from_rows

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # from the axes of OpenGL's camera to those of lmd's, and back
TRANSFORMS, FILES = "transforms.json", ("cameras.txt", "images.txt", "points3D.txt")
COLMAP = {"PINHOLE": 0, "OPENCV": 4, "FULL_OPENCV": 8}  # COLMAP's lens models, with numbers of coefficients
NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
# Line of a COLMAP image: IMAGE_ID, quaternion with w first, translation, CAMERA_ID, NAME. A line of 2-D points has
# only numbers.
IMAGE = re.compile(rf"\s*(\d+)((?:\s+{NUMBER}){{7}})\s+(\d+)\s+(?!{NUMBER}(?:\s|$))(\S(?:.*\S)?)\s*")
# Keys of `TRANSFORMS` about the frame of its poses: how it was found, and a file of points in it.
OF_FRAME = ("applied_transform", "applied_scale", "ply_file_path")


class Model(NamedTuple):
    """Images and their poses from files of COLMAP or nerfstudio, or the times and poses of a trajectory.

    The field `moved` is a function that applies a similarity to the model and returns the new contents of its files.
    """

    names: list[str] | FloatArray
    """Names of n images; for a trajectory, times, seconds, increasing, `(n,)`."""
    poses: FloatArray
    """Poses, camera to the frame of the model, `(n, 4, 4)`."""
    moved: Callable[[FloatArray], Mapping[str, Any]]
    """Function that applies a similarity `(4, 4)` to the model and returns its files' contents, keyed by file name."""


def similar(similarity: FloatArray, poses: FloatArray) -> FloatArray:
    """Move cameras together with the world by a similarity `(4, 4)`; return the new poses of the cameras.

    Old and new poses are `(n, 4, 4)`, camera to world.
    """
    turn = similarity[:3, :3] / np.cbrt(np.linalg.det(similarity[:3, :3]))
    return pose_of(turn @ poses[:, :3, :3], act(similarity, poses[:, :3, 3]))


def image_names(detected: DetectedTags) -> list[list[str]]:
    """Names of the images of C cameras in each of F frames, relative to the folder of the photographs, `(F, C)`. Frames
    that have a time instead of a name, as in a video or a bag, get the name of a PNG file.
    """
    ends = [f"{time}.png" if is_number(time) else time for time in detected.times]
    return [[f"{camera.strip('/')}/{end}".lstrip("/") for camera in detected.cameras] for end in ends]


def read_model(path: Any) -> Model:
    """Read a COLMAP model (a folder with `images.txt` or `images.bin`), `transforms.json`, or a trajectory.

    Raises:
        InputError: the file cannot be read, or has no poses; the message names `align` and the file.
    """
    given = Path(str(path))
    try:
        if given.suffix == ".json" or (given / TRANSFORMS).is_file():
            return _nerfstudio(given / TRANSFORMS if given.is_dir() else given)
        if (given / "images.bin").is_file() and not (given / "images.txt").is_file():
            with tempfile.TemporaryDirectory() as folder:
                optional("pycolmap", "colmap").Reconstruction(str(given)).write_text(folder)
                return _colmap(Path(folder))
        if given.is_dir():
            return _colmap(given)
        rows = read_rows(str(path), frame="optical", columns=None)
    except InputError as error:
        raise InputError(f"align: {path} cannot be read ({str(error).rstrip('.')}).", "align") from None
    except (AttributeError, KeyError, TypeError, ValueError, IndexError, RuntimeError) as error:
        raise InputError(f"align: {path}: the key or value {error} is missing or wrong.", "align") from None
    return Model(rows.time, rows.poses, lambda to: {"model.tum": tum_text(rows.time, similar(to, rows.poses))})


def _colmap(folder: Path) -> Model:
    """Model from the text files of COLMAP in a folder.

    The model's function `moved` returns the files with new poses and new positions of points; all else is unchanged.
    """
    cameras, images, points = (File(folder / name, "model").text.splitlines(keepends=True) for name in FILES)
    found = {number: image for number, line in enumerate(images) if (image := IMAGE.fullmatch(line)) is not None}
    if not found:
        raise InputError("images.txt has no image.")
    numbers = np.array([image[2].split() for image in found.values()], dtype=np.float64)
    with said_of("images.txt"):
        poses = inverse(poses_from_rows(numbers[:, [4, 5, 6, 1, 2, 3, 0]], [number + 1 for number in found]))
    rows = [line.split() for line in points if line[:1].isdigit()]
    places = np.array([row[1:4] for row in rows], dtype=np.float64).reshape(-1, 3)

    def moved(to: FloatArray) -> dict[str, str]:
        own = zip(found.values(), pose_rows(inverse(similar(to, poses))), strict=True)
        lines = dict(zip(found, (_image_line(image[1], row, image[3], image[4]) for image, row in own), strict=True))
        cloud = (_line(row[0], *place, *row[4:]) for row, place in zip(rows, act(to, places).tolist(), strict=True))
        texts = cameras, (lines.get(number, line) for number, line in enumerate(images)), cloud
        return {name: "".join(text) for name, text in zip(FILES, texts, strict=True)}

    return Model([image[4] for image in found.values()], poses, moved)


def _nerfstudio(path: Path) -> Model:
    """Model from nerfstudio's file `transforms.json` at `path`.

    The model's function `moved` returns the file with new poses, and without the keys `OF_FRAME`, which describe the
    old frame. All other keys are unchanged.
    """
    keys = File(path, "model").data
    frames = [dict(frame) for frame in keys["frames"]]
    matrices = np.array([frame["transform_matrix"] for frame in frames], dtype=np.float64)
    if matrices.shape[1:] != (4, 4) or not are_rotations(matrices[:, :3, :3]).all():
        raise InputError("frames must have a transform_matrix each, a rigid motion of four rows.")
    poses = matrices @ OPENGL

    def moved(to: FloatArray) -> dict[str, Any]:
        own = zip(frames, (similar(to, poses) @ OPENGL).tolist(), strict=True)
        rest = {key: value for key, value in keys.items() if key not in OF_FRAME}
        return {TRANSFORMS: {**rest, "frames": [{**frame, "transform_matrix": matrix} for frame, matrix in own]}}

    return Model([str(frame["file_path"]) for frame in frames], poses, moved)


def _line(*values: Any) -> str:
    return " ".join(map(str, values)) + "\n"


def _image_line(number: Any, row: FloatArray, camera: Any, name: str) -> str:
    """Line of COLMAP's `images.txt`.

    Args:
        number: number of the image.
        row: pose, world to camera: x, y, z, qx, qy, qz, qw.
        camera: number of the camera.
        name: name of the image.
    """
    return _line(number, *row[[6, 3, 4, 5, 0, 1, 2]].tolist(), camera, name)


def _intrinsics(camera: Camera) -> tuple[str, str, dict[str, float]]:
    """Names of a camera's lens model in COLMAP and in nerfstudio, and the camera's parameters for both programs.

    Returns:
        name in COLMAP; name in nerfstudio; and size of the image, focal lengths, principal point and coefficients of
        the lens. These values are in COLMAP's order, keyed by nerfstudio's names. A name is empty if the program lacks
        the lens model.
    """
    (focal_u, focal_v), (u, v), lens = camera.focal_pixels.tolist(), camera.principal_point, camera.distortion
    size = {"w": round(camera.image_width), "h": round(camera.image_height)}
    values = size | {"fl_x": focal_u, "fl_y": focal_v, "cx": u, "cy": v}
    if camera.distortion_model == EQUIDISTANT:
        return "OPENCV_FISHEYE", "OPENCV_FISHEYE", values | dict(zip(Equidistant._fields, lens, strict=True))
    model = next((name for name, count in COLMAP.items() if not any(lens[count:])), "")
    own = dict(zip(BrownConrady._fields[: COLMAP.get(model)], (*lens, 0.0, 0.0, 0.0), strict=False))
    return model, "OPENCV" * (not any(lens[5:])), values | own


def model_files(
    cameras: Sequence[Camera], names: Sequence[str], camera: IntArray, poses: FloatArray, points: FloatArray
) -> tuple[dict[str, Any], str]:
    """Contents of the files of a COLMAP model and of nerfstudio's `TRANSFORMS`, and a note on files that are left out.

    Args:
        cameras: the cameras.
        names: names of n images.
        camera: index of the camera of each image, `(n,)`.
        poses: poses, camera to world, metres, `(n, 4, 4)`.
        points: points of the model, metres, `(m, 3)`.

    Returns:
        contents, keyed by file name; and the note, which is empty if no file is left out. A file is left out if its
        program lacks a lens model, or if `TRANSFORMS` would need several lens models.
    """
    lenses, each = [_intrinsics(one) for one in cameras], list(zip(names, camera.tolist(), strict=True))
    rows = enumerate(zip(each, pose_rows(inverse(poses)), strict=True), 1)
    texts = (
        [_line(k, model, *values.values()) for k, (model, _, values) in enumerate(lenses, 1)],
        [_image_line(k, row, own + 1, name) + "\n" for k, ((name, own), row) in rows],
        [_line(k, *point, 128, 128, 128, 0) for k, point in enumerate(points.tolist(), 1)],
    )
    named = zip(FILES, texts, strict=True) if all(model for model, _, _ in lenses) else ()
    files: dict[str, Any] = {f"colmap/{name}": "".join(own) for name, own in named}
    if len(kinds := {kind for _, kind, _ in lenses}) == 1 and "" not in kinds:
        matrices = zip(each, (poses @ OPENGL).tolist(), strict=True)
        views = [{"file_path": name, **lenses[k][2], "transform_matrix": one} for (name, k), one in matrices]
        files[TRANSFORMS] = {"camera_model": kinds.pop(), **lenses[0][2], "frames": views}
    lacking = "nerfstudio has" if files else "COLMAP and nerfstudio have"
    return files, "" if TRANSFORMS in files else f"{lacking} no single model for these lenses: no such file is written"
