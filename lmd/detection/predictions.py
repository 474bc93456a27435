"""Comparison of a visibility model's predictions with detections in frames: metrics and tables."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from lmd.core.checks import BoolArray, FloatArray
from lmd.core.words import escaped, markdown_table
from lmd.detection.corner_errors import incidence, pitch
from lmd.detection.detectors import (
    TAG_NUMBERS,
    Matches,
    agreement,
    corner_error,
    precision_recall,
    quantiles_by,
    shares_of_frames,
)
from lmd.detection.frames import overlapping
from lmd.geometry.pose import body_from_corners, pose_error
from lmd.render.renderer import Renderer

# Bounds of the classes of pitch, pixels per module, and of the incidence angle, degrees.
PITCHES = np.array([0.0, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 6.0, 9.0, np.inf])
INCIDENCES = np.array([0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0])
QUANTILES = {"median": 0.5, "90": 0.9}


@dataclass(frozen=True)
class CameraPrediction:
    """Tags that a visibility model predicts to be visible in N frames of one camera, in a room with K tags."""

    renderer: Renderer
    """Camera and tags."""
    poses: FloatArray
    """Poses of the camera, camera to world, `(N, 4, 4)`."""
    visible: BoolArray
    """Mask of the tags that are visible according to the model, `(N, K)`."""
    met: Mapping[str, BoolArray]
    """For each criterion of the visibility model, the mask of the tags that meet it, `(N, K)`, keyed by the criterion's
    name; empty if the model has no criteria.
    """
    taken: BoolArray | None = None
    """Mask of the frames with an image, `(N,)`; None if all frames have one. A frame without an image has no visible
    and no whole tags.
    """
    people: Sequence[FloatArray] | None = None
    """For each of the N frames, the people who may hide tags, as cylinders (x, y, radius, lower and upper z, metres),
    `(M, 5)`; None without a crowd.
    """

    @cached_property
    def corners(self) -> FloatArray:
        """Exact image points of the tags' corners, pixels, `(N, K, 4, 2)`."""
        return self.renderer.corners(self.poses)

    @cached_property
    def whole(self) -> BoolArray:
        """Mask of the *whole* tags, `(N, K)`: those that face the camera and have all corners in the image."""
        inside = self.renderer.inside(self.poses)
        return inside if self.taken is None else inside & self.taken[:, None]

    @cached_property
    def pitch(self) -> FloatArray:
        """Pitch, pixels per module, `(N, K)`; NaN for tags that are not whole."""
        room = self.renderer.room
        values = pitch(self.renderer.camera, self.poses, room.centres, room.normals, room.tag, room.edges)
        return np.where(self.whole, values, np.nan)

    @cached_property
    def incidence(self) -> FloatArray:
        """Angle between a tag's normal and the direction to the camera, degrees, `(N, K)`; NaN for tags that are not
        whole.
        """
        room = self.renderer.room
        return np.where(self.whole, np.degrees(incidence(self.poses, room.centres, room.normals)), np.nan)


def _beside(name: str) -> cached_property[NDArray[Any]]:
    """Make a property: the array attribute `name` of all C cameras, joined along the axis of tags, `(N, C K, ...)`."""
    return cached_property(lambda whole: np.concatenate([getattr(part, name) for part in whole.parts], axis=1))


@dataclass(frozen=True)
class Prediction:
    """Tags that a visibility model predicts to be visible in N frames of the C cameras on one body.

    Arrays have a column for each pair of a camera and one of the K tags; the columns of the first camera come first.
    """

    parts: tuple[CameraPrediction, ...]
    """Prediction of each camera."""
    mounted: FloatArray
    """Poses of the cameras in the frame of the body, `(C, 4, 4)`."""
    poses: FloatArray
    """Poses of the body, body to world, `(N, 4, 4)`."""

    visible = _beside("visible")
    corners = _beside("corners")
    whole = _beside("whole")
    pitch = _beside("pitch")
    incidence = _beside("incidence")

    @cached_property
    def met(self) -> Mapping[str, BoolArray]:
        """For each criterion of the visibility model, keyed by name, the mask of the tags that meet it, `(N, C K)`."""
        names = self.parts[0].met
        return {name: np.concatenate([part.met[name] for part in self.parts], axis=1) for name in names}

    @cached_property
    def overlapping(self) -> BoolArray:
        """Mask of the tags that overlap another tag on the wall, `(K,)`."""
        return overlapping(self.parts[0].renderer.room)

    def by_any(self, which: BoolArray) -> BoolArray:
        """Mask of the tags for which the mask `which` `(N, C K)` is True in at least one of the C cameras, `(N, K)`."""
        return np.asarray(which.reshape(len(which), len(self.parts), -1).any(axis=1))


def figures(prediction: Prediction, seen: Matches) -> dict[str, float]:
    """Metrics of one deployment and one detector.

    A frame of a rig consists of the simultaneous images of all cameras. In `predicted_<n>`, `detected_<n>` and
    `agreement_<n>`, a tag counts once if at least one camera shows it. The metrics of single tags below count a tag
    once for each frame and camera.

    - `frames`, `tags`, `overlapping`: numbers of frames, of tags, and of tags that overlap another tag.
    - `predicted_<n>`, `detected_<n>`: P(>= n), the fraction of frames with at least n tags; with the suffix `_error`,
      its standard error.
    - `agreement_<n>`: fraction of frames in which prediction and detection agree on whether at least n tags are found.
    - `precision`, `recall`: precision and recall over all tags in all frames.
    - `left_out`: number of tags that are detected but not predicted; `left_out_<criterion>`: number of these tags that
      fail a criterion of the visibility model.
    - `overrated`: number of tags that are predicted but not detected. `overrated_cut` is the number of these tags that
      the image border cuts; `overrated_overlapping` is the number of those not cut that overlap another tag.
    - `false_a_frame`: false detections per frame.
    - `corner_median`, `corner_90`: quantiles of the corner error, pixels.
    - `pose_share`: fraction of frames whose detections determine the pose of the camera or of the rig's body.
    - `position_median`, `position_90`, `attitude_median`, `attitude_90`: quantiles of the errors of this pose, metres
      and rad.
    """
    part = prediction.parts[0]
    row: dict[str, float] = {"frames": len(prediction.poses), "tags": part.visible.shape[1]}
    row["overlapping"] = int(prediction.overlapping.sum())
    visible, detected = prediction.visible, seen.detected
    by_model, by_detector = prediction.by_any(visible), prediction.by_any(detected)
    for name, which in (("predicted", by_model), ("detected", by_detector)):
        for n, share, error in zip(TAG_NUMBERS, *shares_of_frames(which), strict=True):
            row[f"{name}_{n}"], row[f"{name}_{n}_error"] = float(share), float(error)
    row |= {f"agreement_{n}": agreement(by_model, by_detector, int(n)) for n in TAG_NUMBERS}
    precision, recall = precision_recall(visible, detected)
    row |= {"precision": float(precision), "recall": float(recall)}
    left_out, overrated = detected & ~visible, visible & ~detected
    row["left_out"] = int(left_out.sum())
    row |= {f"left_out_{name}": int((left_out & ~met).sum()) for name, met in prediction.met.items()}
    row["overrated"], row["overrated_cut"] = int(overrated.sum()), int((overrated & ~prediction.whole).sum())
    on_others = np.tile(prediction.overlapping, len(prediction.parts))
    row["overrated_overlapping"] = int((overrated & prediction.whole & on_others).sum())
    row["false_a_frame"] = float(seen.false.mean())
    row |= _quantiles("corner", corner_error(seen.corners, prediction.corners))
    cameras = [part.renderer.camera for part in prediction.parts]
    images = seen.corners.reshape(len(seen.corners), len(cameras), -1, 4, 2)
    known = prediction.mounted, part.renderer.room.corners
    poses = np.stack([body_from_corners(cameras, *known, list(moment)) for moment in images])
    position, attitude = pose_error(prediction.poses, poses)
    row["pose_share"] = float(np.isfinite(position).mean())
    return row | _quantiles("position", position) | _quantiles("attitude", attitude)


def _quantiles(name: str, values: FloatArray) -> dict[str, float]:
    """Quantiles of the finite values, at the probabilities `QUANTILES`, keyed by `name` with a suffix; NaN if no value
    is finite.
    """
    known = values[np.isfinite(values)]
    return {f"{name}_{key}": float(np.quantile(known, q)) if known.size else np.nan for key, q in QUANTILES.items()}


def by_pitch(prediction: Prediction, seen: Matches) -> pd.DataFrame:
    """Table of whole tags in bins of pitch.

    Columns: `pitch_from`, `pitch_to` (pixels per module), number of `tags`, the fractions that are `predicted` and
    `detected`, and `corner_median`, `corner_90` (pixels). Bins without a tag are left out.
    """
    return _by_class(prediction, seen, "pitch", prediction.pitch, PITCHES)


def by_incidence(prediction: Prediction, seen: Matches) -> pd.DataFrame:
    """Table of whole tags in bins of incidence angle.

    Columns: `incidence_from`, `incidence_to` (degrees), number of `tags`, the fractions that are `predicted` and
    `detected`, and `corner_median`, `corner_90` (pixels). Bins without a tag are left out.
    """
    return _by_class(prediction, seen, "incidence", prediction.incidence, INCIDENCES)


SHARES = ("tags", "predicted", "detected")  # columns of `_shares`


def _shares(prediction: Prediction, seen: Matches, members: BoolArray) -> dict[str, float]:
    """Number of `tags` in the mask `members`, and fractions of these tags that are `predicted` and `detected`.

    The mask `(N, C K)` has a column for each pair of a camera and a tag.
    """
    shares = {"predicted": prediction.visible[members].mean(), "detected": seen.detected[members].mean()}
    return {"tags": int(members.sum())} | shares


def _by_class(prediction: Prediction, seen: Matches, name: str, values: FloatArray, bounds: FloatArray) -> pd.DataFrame:
    """Table of whole tags, with a row for each bin of `values` that contains a tag.

    `values` `(N, C K)` has a number for each frame, camera and tag; `bounds` are the edges of the bins. Columns:
    `<name>_from`, `<name>_to`, `tags`, `predicted`, `detected`, `corner_median`, `corner_90`.
    """
    error = corner_error(seen.corners, prediction.corners)
    place = np.searchsorted(bounds, values, side="right") - 1
    quantiles = quantiles_by(values, error, bounds, tuple(QUANTILES.values()))
    rows = []
    for b, corner in enumerate(quantiles):
        members = (place == b) & prediction.whole
        if members.any():
            span = {f"{name}_from": bounds[b], f"{name}_to": bounds[b + 1]}
            corners = {f"corner_{key}": q for key, q in zip(QUANTILES, corner, strict=True)}
            rows.append(span | _shares(prediction, seen, members) | corners)
    corners_of = (f"corner_{key}" for key in QUANTILES)
    return pd.DataFrame(rows, columns=[f"{name}_from", f"{name}_to", *SHARES, *corners_of])


def by_tag(prediction: Prediction, seen: Matches) -> pd.DataFrame:
    """Table with a row for each tag. Columns: `id`; `overlapping`; `predicted` and `detected`, the numbers of frames in
    which the tag is predicted and detected; `precision`; `recall`.

    In a frame of a rig, a tag counts as predicted (or detected) if it is predicted (or detected) for any camera.
    """
    visible, detected = prediction.by_any(prediction.visible), prediction.by_any(seen.detected)
    precision, recall = precision_recall(visible, detected, axis=0)
    return pd.DataFrame({
        "id": prediction.parts[0].renderer.room.ids,
        "overlapping": prediction.overlapping,
        "predicted": visible.sum(axis=0),
        "detected": detected.sum(axis=0),
        "precision": precision,
        "recall": recall,
    })  # fmt: skip


def to_markdown(table: pd.DataFrame) -> str:
    """Format the metrics of `figures` as two Markdown tables, each with one row for each deployment and detector.

    Args:
        table: columns `deployment` and `detector`, followed by the metrics of `figures`.
    """
    criteria = [c.removeprefix("left_out_") for c in table.columns if c.startswith("left_out_")]
    names = ["deployment", "detector"]
    head = [*names, *(f"P(>= {n}) predicted / detected" for n in TAG_NUMBERS), "frames agree on >= 2"]
    head += ["precision / recall of tags", "false a frame", "corners: median / 90 % [px]", "frames with a pose"]
    head += ["position: median / 90 % [mm]"]
    blame = [*names, "detected, not predicted", *(escaped(f"of these fail {c.replace('_', ' ')}") for c in criteria)]
    blame += ["predicted, not detected", "of these cut by the border", "of the others overlapping"]
    rows, wrong = [], []
    for row in table.to_dict("records"):
        own = [escaped(row[name]) for name in names]
        rows.append([
            *own,
            *(f"{row[f'predicted_{n}']:.3f} / {row[f'detected_{n}']:.3f} ± {row[f'detected_{n}_error']:.3f}"
              for n in TAG_NUMBERS),
            f"{row['agreement_2']:.1%}",
            f"{row['precision']:.3f} / {row['recall']:.3f}",
            f"{row['false_a_frame']:.3f}",
            f"{row['corner_median']:.2f} / {row['corner_90']:.2f}",
            f"{row['pose_share']:.1%}",
            f"{1e3 * row['position_median']:.2f} / {1e3 * row['position_90']:.2f}",
        ])  # fmt: skip
        counts = ["left_out", *(f"left_out_{c}" for c in criteria), "overrated", "overrated_cut"]
        wrong.append([*own, *(f"{row[key]:,.0f}" for key in (*counts, "overrated_overlapping"))])
    return f"{markdown_table(head, rows)}\n\n{markdown_table(blame, wrong)}\n"
