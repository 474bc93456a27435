"""Results that a survey and a localisation share: table rows, metrics and lines of text about an estimate."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lmd.adjust.estimate import Estimate
from lmd.adjust.gauge import in_world
from lmd.adjust.sightings import SQUARE
from lmd.core.checks import FloatArray
from lmd.core.words import few
from lmd.formats.detections import DetectedTags
from lmd.formats.reconstructions import image_names, model_files
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import ROW, act, pose_rows

AXES = ("x", "y", "z", "rx", "ry", "rz")  # axes of positions and rotations in the world
TWISTS = ("tilt_x", "tilt_y", "turn", "right", "up", "out")  # components of a twist in the frame of a tag
NOTICED = 0.01  # a floor of the corners' standard deviation is printed if it exceeds this, pixels
a_few = partial(few, most=12)


def pose_columns(poses: FloatArray) -> dict[str, ArrayLike]:
    """Columns of a table with the positions and quaternions of the poses `(n, 4, 4)`, keyed by the names in `ROW`.
    Poses of NaN give empty cells.
    """
    return dict(zip(ROW, pose_rows(poses).T, strict=True))


def covariance_columns(poses: FloatArray, covariances: FloatArray) -> dict[str, ArrayLike]:
    """Columns of a table with the covariances of position and rotation in the world frame, keyed by name. The columns
    hold the upper triangle of each matrix, row by row. `covariances` `(n, 6, 6)` are those of the twists of the `poses`
    `(n, 4, 4)`.
    """
    world = in_world(poses, covariances)
    return {f"cov_{AXES[i]}_{AXES[j]}": world[:, i, j] for i in range(6) for j in range(i, 6)}


def quantiles(name: str, values: FloatArray) -> dict[str, float]:
    """Median and 90 % quantile of the values that are not NaN, keyed by `name` with the suffixes `/50` and `/90`. Empty
    if all values are NaN.
    """
    known = values[np.isfinite(values)]
    return {f"{name}/{share}": float(np.quantile(known, share / 100.0)) for share in (50, 90)} if known.size else {}


def both(figures: Mapping[str, float], name: str, factor: float = 1e3, digits: str = ".2g") -> str:
    """Text with the median and the 90 % quantile of the quantity `name`, taken from `figures` (see `quantiles`). Both
    are multiplied by `factor`, and printed in the format `digits`.
    """
    low, high = (factor * figures[f"{name}/{share}"] for share in (50, 90))
    return f"{low:{digits}} (90 %: {high:{digits}})"


def plain(values: ArrayLike) -> list[Any]:
    """Values for JSON, with None (null) in place of NaN."""
    return [None if value != value else value for value in np.asarray(values).tolist()]


def figures_of(found: Estimate) -> dict[str, float]:
    """Metrics of an estimate, keyed by name: number of inliers, errors in pixels, and the factor `inflation`."""
    return {
        "sightings": float(found.used.sum()),
        "corner_floor": found.floor,
        "inflation": found.inflation,
        **quantiles("error", np.sqrt(found.squares[found.used] / 4.0)),
    }


def clock_figures(found: Estimate) -> dict[str, float]:
    """Offset of the odometry's clock and its standard deviation, seconds, keyed by name; empty without odometry."""
    return {f"clock_{name}": getattr(found.clock, name) for name in ("offset", "sigma")} if found.clock else {}


def document_of(found: Estimate, detected: DetectedTags, sizes: Mapping[int, float]) -> dict[str, Any]:
    """Content of a JSON file about the clock, images, cameras and wrong sizes. `sizes` has the estimated edge lengths,
    metres, keyed by id, of tags whose stated size is wrong.
    """
    return {
        "clock": found.clock and found.clock.sentence,
        "blurred": dict(detected.blurred),
        "copies": dict(detected.copies),
        "intrinsics": [camera.document() for camera in found.calibrated],
        "sizes": {str(tag): edge for tag, edge in sizes.items()},
    }


def lines_of(
    found: Estimate, detected: DetectedTags, sizes: Mapping[int, float], doubts: Sequence[str]
) -> dict[str, str]:
    """Lines for a terminal, keyed by label: errors of corners, the clock, cameras, images, wrong sizes and doubts.
    `sizes` has the estimated edge lengths, metres, keyed by id, of tags whose stated size is wrong. `doubts` are
    sentences on values that contradict the images.
    """
    lines, cameras = {}, found.calibrated
    if found.used.any():
        lines["corners"] = f"{both(figures_of(found), 'error', 1.0)} pixels off"
        if found.floor > NOTICED:
            lines["corners"] += f", of which {found.floor:.2g} (one standard deviation) are not the detector's"
    if found.clock is not None:
        lines["clock"] = found.clock.sentence
    if found.inflation > 1.0:
        more = f"{found.inflation:.1f} times as much as the noise of corners explains"
        lines["blocks"] = f"of time disagree {more}; the standard deviations include this"
    for number, camera in enumerate(cameras, 1):
        lines[f"camera {number}" if len(cameras) > 1 else "camera"] = camera.to_text()
    copies = [f"such as {copy} of {first}" for copy, first in detected.copies.items()]
    rest = {
        "other size": a_few(f"{tag} ({1e3 * edge:.4g} mm)" for tag, edge in sizes.items()),
        "blurred": a_few(f"{name} ({pixels:.2g} pixels)" for name, pixels in detected.blurred.items()),
        "copies": f"{len(copies)} images, not counted: {copies[0]}" if copies else "",
        "check": " ".join(doubts),
    }
    return lines | {label: text for label, text in rest.items() if text}


def files_of_model(found: Estimate, detected: DetectedTags, cameras: Sequence[Camera]) -> tuple[dict[str, Any], str]:
    """Contents of model files for other programs, keyed by file name, and a note on the files that are left out.

    The model has the images of an estimate and their poses; its points are the corners of the tags. See
    `lmd.formats.reconstructions.model_files`.

    Args:
        found: the estimate.
        detected: the detections.
        cameras: given cameras; the model has these if the estimate did not refine them.
    """
    through, poses, some = [one.found for one in found.calibrated] or cameras, found.poses, found.sightings
    frame, camera = np.nonzero(detected.images & poses.known_frames[:, None])
    names = np.array(image_names(detected))[frame, camera].tolist()
    known = poses.known_tags & (found.group == 0)
    corners = act(poses.tags[known], some.present_edges[known, None, None] / 2.0 * SQUARE)
    return model_files(through, names, camera, poses.frames[frame] @ poses.mounts[camera], corners.reshape(-1, 3))
