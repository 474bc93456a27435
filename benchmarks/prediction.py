"""What visibility=fiducial foresees in a recording, and why it errs: `python benchmarks/prediction.py FOLDER EDGE`.

The folder has `detections.csv`, `frames.csv` with all images, and `cameras.yaml` with the cameras in the order of their
names. All is surveyed at once; limits and image circles are fitted to the first half in time, and judged on the second.
Prints Markdown: the model as it comes and step by step, beside a logistic regression on the variables of the last
table; the limits; why tags are missed; and how the share that is found depends on each variable. With `--figure
FILE.png` it draws where in the images tags within all limits were found and missed.
"""

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from lmd.core.checks import BoolArray, FloatArray, IntArray
from lmd.core.tables import write_table
from lmd.detection.calibration import fit
from lmd.detection.corner_errors import CORNER_ERRORS
from lmd.detection.detectors import AprilTagDetector, corner_error, precision_recall
from lmd.detection.tag_views import FILE, SurveyedViews
from lmd.evaluation.audit import IN_A_ROW, Audit, audited, in_the_open, view_columns
from lmd.evaluation.verdicts import verdicts
from lmd.formats.calibrations import calibrated_camera, read_cameras
from lmd.formats.detection_formats import read_detections, with_images
from lmd.geometry.camera import Camera
from lmd.geometry.projection import intrinsics
from lmd.render.imaging import Imaging
from lmd.scene.pdf import solid_angle
from lmd.scene.rig import Mount, Rig
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag
from lmd.sight.models.fiducial import Fiducial
from lmd.sight.models.limits import NAMES, Limits
from lmd.space.cuboid import Cuboid
from lmd.survey.knowledge import PriorKnowledge
from lmd.survey.survey import Survey, survey

FARTHEST = "farthest corner from the lens's centre, pixels"
METRE = (1.0, 1.0, 1.0)


def audit_of(found: Survey, cameras: list[Camera], tag: Tag, limits: Limits | None) -> Audit:
    """What the model says of the frames in an empty room, by AprilTag's preset without limits."""
    model = Fiducial(tag, "apriltag", limits)
    body = cameras[0] if len(cameras) == 1 else Rig(tuple(Mount(camera) for camera in cameras))
    scene = Scene(Cuboid(METRE, METRE, 1.0), body, solid_angle(1), model, tag)
    return audited(*in_the_open(found, scene), verdicts)


def used_of(found: Survey) -> BoolArray:
    """Which tags the survey places by what was detected in its frames, `(N, C K)`: all that audits counted once."""
    some, own = found.found.sightings, found.found.used & found.placed[found.found.sightings.tag]
    tag = np.cumsum(found.placed) - 1
    used = np.zeros((len(found.found.frames), some.cameras, int(found.placed.sum())), dtype=bool)
    used[np.searchsorted(found.found.frames, some.frame[own]), some.camera[own], tag[some.tag[own]]] = True
    return used.reshape(len(used), -1)


class Verdict(NamedTuple):
    """A row of the first table."""

    name: str
    predicted: BoolArray
    detected: BoolArray
    asked: BoolArray

    def row(self) -> str:
        """Figures of the tags that are asked about."""
        predicted, detected = self.predicted & self.asked, self.detected & self.asked
        right = float((predicted == detected)[self.asked].mean())
        precision, recall = precision_recall(predicted, detected)
        each = predicted.sum() / len(predicted), detected.sum() / len(detected)
        counts = f"{each[0]:.2f} | {each[1]:.2f}"
        return (
            f"| {self.name} | {right:.3f} | {precision:.3f} | {recall:.3f} | {counts} | {each[0] / each[1] - 1:+.3f} |"
        )


def variables(audit: Audit, times: FloatArray) -> dict[str, FloatArray]:
    """What finding a tag may depend on, `(N, C K)` each."""
    seen = audit.prediction
    parts = seen.parts
    centres, corners = seen.corners.mean(axis=2), seen.corners
    count = centres.shape[1] // len(parts)
    gaps = np.diff(times)[:, None]
    steps = np.linalg.norm(np.diff(centres, axis=0), axis=-1) / gaps * np.median(gaps)
    none = np.full((1, centres.shape[1]), np.nan)
    speed = np.fmax(np.concatenate([none, steps]), np.concatenate([steps, none]))
    away, border, above = [], [], []
    for c, part in enumerate(parts):
        own, camera = corners[:, c * count : (c + 1) * count], part.renderer.camera
        matrix, focal = intrinsics(camera), camera.focal_pixels
        away.append(np.linalg.norm((own - matrix[:2, 2]) / focal * focal.max(), axis=-1).max(axis=-1))
        border.append(np.minimum(own, [camera.image_width, camera.image_height] - own).min(axis=(2, 3)))
        ray = part.renderer.room.centres - part.poses[:, None, :3, 3]
        above.append(np.degrees(np.arcsin(ray[..., 2] / np.linalg.norm(ray, axis=-1))))
    side = corners[:, :, 1] - corners[:, :, 0]
    roll = np.degrees(np.arctan2(side[..., 1], side[..., 0])) % 90.0
    return {
        "pixels a module": seen.pitch,
        "incidence, degrees": seen.incidence,
        FARTHEST: np.concatenate(away, axis=1),
        "nearest corner to the border, pixels": np.concatenate(border, axis=1),
        "motion in the image, pixels a frame": speed,
        "edges off the pixels' axes, degrees": np.minimum(roll, 90.0 - roll),
        "tag above the camera's horizon, degrees": np.concatenate(above, axis=1),
        "time, s": np.broadcast_to((times - times[0])[:, None], roll.shape),
    }


def thirds(known: Mapping[str, FloatArray], audit: Audit) -> Iterator[str]:
    """Rows: the share found of those within the limits, in three classes of each variable with as many tags.

    In brackets, the median error of the corners of these, pixels.
    """
    detected, within = audit.seen.detected, audit.prediction.visible & audit.prediction.whole
    error = corner_error(audit.seen.corners, audit.prediction.corners)
    for name, values in known.items():
        own = within & np.isfinite(values)
        bounds = np.quantile(values[own], [1 / 3, 2 / 3])
        kind = np.searchsorted(bounds, values)
        classes = [own & (kind == k) for k in range(3)]
        cells = [f"{detected[one].mean():.3f} ({np.nanmedian(error[one & detected]):.2f})" for one in classes]
        yield f"| {name} | {bounds[0]:.1f}, {bounds[1]:.1f} | {' | '.join(cells)} |"


def regression(known: Mapping[str, FloatArray], detected: BoolArray, train: BoolArray, test: BoolArray) -> float:
    """The share that a logistic regression foresees rightly: each variable by itself and squared."""
    columns = np.stack([values for name, values in known.items() if not name.startswith("time")], axis=-1)
    filled = np.where(np.isfinite(columns), columns, np.nanmedian(columns[train], axis=0))
    mean, spread = filled[train].mean(axis=0), filled[train].std(axis=0)
    scaled = np.clip((filled - mean) / spread, -4.0, 4.0)
    design = np.concatenate([np.ones((*scaled.shape[:-1], 1)), scaled, scaled**2], axis=-1)
    x, y = design[train], np.where(detected[train], 1.0, -1.0)

    def loss(weights: FloatArray) -> tuple[float, FloatArray]:
        at = y * (x @ weights)
        slope = -y / (1.0 + np.exp(np.clip(at, -500.0, 500.0)))
        return float(np.logaddexp(0.0, -at).sum() + 0.5 * weights @ weights), x.T @ slope + weights

    weights = minimize(loss, np.zeros(x.shape[1]), jac=True, method="L-BFGS-B").x
    return float(((design[test] @ weights > 0.0) == detected[test]).mean())


def causes(audit: Audit, asked: BoolArray, taken: BoolArray, beyond: BoolArray) -> Iterator[str]:
    """Rows: tags that an image should show, `asked`, by the first limit that they fail, all `(N, C K)`.

    Args:
        audit: of the fitted limits.
        asked: show their front with all corners in an image, if it was taken.
        taken: likewise, in one that was.
        beyond: the image circle.
    """
    visible, detected = audit.prediction.visible, audit.seen.detected
    rest, rows = taken, [("no image was taken", asked & ~taken)]
    for name, fails in (("beyond the image circle", beyond), ("too oblique", ~audit.prediction.met["facing"])):
        rows.append((name, rest & fails))
        rest = rest & ~fails
    rows += [("too small", rest & ~visible), ("within all limits", rest & visible)]
    for name, which in rows:
        share = f"{detected[which].mean():.3f}" if which.any() else ""
        yield f"| {name} | {which.sum()} | {share} | {(which & ~detected).sum()} |"
    runs, missed = audit.missed_in_a_row & asked, rest & visible & ~detected
    yield f"| of these, in {IN_A_ROW} images of the tag in a row or more | | | {runs.sum()} |"
    yield f"| of these, fewer in a row | | | {(missed & ~runs).sum()} |"


def draw(file: Path, audit: Audit, late: BoolArray) -> None:
    """Where tags within all limits were found and missed: a row for each camera, a column for each half."""
    import matplotlib.pyplot as plt

    parts = audit.prediction.parts
    figure, axes = plt.subplots(len(parts), 2, figsize=(9.0, 4.0 * len(parts)), squeeze=False, layout="constrained")
    split = [np.split(values, len(parts), axis=1) for values in (audit.prediction.corners.mean(axis=2), late)]
    visible, detected = audit.prediction.visible, audit.seen.detected
    kinds = [np.split(visible & which, len(parts), axis=1) for which in (detected, ~detected)]
    for c, part in enumerate(parts):
        centres, second = split[0][c], split[1][c]
        for half, axis in enumerate(axes[c]):
            for which, colour, name in zip(kinds, ("tab:blue", "tab:red"), ("found", "missed"), strict=True):
                u, v = centres[which[c] & (second == bool(half))].T
                axis.scatter(u, v, s=3, color=colour, linewidths=0, label=name)
            axis.set(xlim=(0, part.renderer.camera.image_width), ylim=(part.renderer.camera.image_height, 0))
            axis.set(aspect="equal", title=f"camera {c + 1}, {('first', 'second')[half]} half")
    axes[0, 0].legend(loc="upper left", markerscale=4)
    figure.savefig(file, dpi=75)


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("edge", type=float, help="of the tags, metres")
    parser.add_argument("--figure", type=Path)
    given = parser.parse_args()
    folder, tag, path = given.folder, Tag(given.edge), str(given.folder / "cameras.yaml")
    detected = with_images(read_detections(folder / "detections.csv"), folder / "frames.csv")
    cameras = [calibrated_camera(path, name or None) for name in list(read_cameras(path))[: len(detected.cameras)]]
    found = survey(detected, cameras, tag, CORNER_ERRORS["apriltag"], PriorKnowledge())
    with TemporaryDirectory() as left:
        write_table(Path(left) / FILE, view_columns(found, cameras, tag, None))
        rng = np.random.default_rng(0)
        views = SurveyedViews(left).views(cameras, tag, AprilTagDetector(), Imaging(), rng)
        limits = fit(views, rng, 0.0)
    rounds = [
        replace(camera, image_circle=diameter) if np.isfinite(diameter) else camera
        for camera, diameter in zip(cameras, limits.circles, strict=True)
    ]
    blind = replace(found, detected=replace(found.detected, taken=None))
    as_it_comes, told = audit_of(blind, cameras, tag, None), audit_of(found, cameras, tag, None)
    fitted = audit_of(found, rounds, tag, limits.limits)
    asked, whole, seen = as_it_comes.prediction.whole, told.prediction.whole, fitted.seen.detected
    frames: IntArray = found.found.frames
    times = np.array([float(found.detected.times[frame]) for frame in frames.tolist()])
    moments = np.unique(views.placed.moment) if views.placed is not None else frames
    late = np.zeros_like(whole)
    late[len(moments) // 2 :] = True
    known = variables(replace(fitted, prediction=told.prediction), times)
    preset, used = told.prediction.visible, used_of(found)
    print(
        "| on the second half | right | precision | recall | predicted a frame | detected a frame | predicted, of it |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for verdict in (
        Verdict("AprilTag's preset; detected is what places tags", as_it_comes.prediction.visible, used, asked & late),
        Verdict("without images that were not taken", preset, used, whole & late),
        Verdict("detected is what is off by 5 pixels or less", preset, seen, whole & late),
        Verdict("limits and image circles of the first half", fitted.prediction.visible, seen, whole & late),
        Verdict("likewise, of the first half itself", fitted.prediction.visible, seen, whole & ~late),
    ):  # fmt: skip
        print(verdict.row())
    for c, name in enumerate(found.detected.cameras if len(cameras) > 1 else ()):
        own = np.repeat(np.arange(len(cameras)) == c, whole.shape[1] // len(cameras))
        print(Verdict(f"of the second, {name} alone", fitted.prediction.visible, seen, whole & late & own).row())
    share = regression(known, seen, whole & ~late, whole & late)
    fits = ", ".join(f"{name} {getattr(limits.limits, name):.3g}" for name in NAMES)
    text = f"{fits}; image circles {', '.join(f'{diameter:.0f}' for diameter in limits.circles)} pixels"
    print(f"\nA logistic regression of the first half is right in {share:.3f} of the second.\n\n{text}\n")
    print("| tags that show their front wholly | number | found | missed |\n| --- | --- | --- | --- |")
    beyond = 2.0 * known[FARTHEST] > np.repeat(limits.circles, whole.shape[1] // len(cameras))
    print("\n".join(causes(fitted, asked, whole, beyond)))
    print("\n| within all limits, share found | thirds end at | lowest | middle | highest |")
    print("| --- | --- | --- | --- | --- |")
    print("\n".join(thirds(known, fitted)))
    if given.figure is not None:
        draw(given.figure, fitted, late)


if __name__ == "__main__":
    main()
