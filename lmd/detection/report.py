"""What was predicted of frames beside what detectors made of them: rows of tables."""

import numpy as np
import pandas as pd

from lmd.core.checks import BoolArray, FloatArray
from lmd.core.words import escaped, markdown_table
from lmd.detection.evaluation import TAG_NUMBERS, agreement, at_least, corner_error, precision_recall, quantiles_by
from lmd.detection.frames import Sightings
from lmd.detection.prediction import Predicted
from lmd.geometry.pose import body_from_corners, pose_error

# Classes of pitch, pixels a module.
PITCHES = np.array([0.0, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 6.0, 9.0, np.inf])
INCIDENCES = np.array([0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0])  # degrees
PLACES = np.array([4, 3])  # parts of an image, from left to right and from top to bottom
QUANTILES = {"median": 0.5, "90": 0.9}


def _by_any(which: BoolArray, prediction: Predicted) -> BoolArray:
    """What any camera has, `(N, C K)` -> `(N, K)`."""
    return np.asarray(which.reshape(len(which), len(prediction.parts), -1).any(axis=1))


def figures(prediction: Predicted, seen: Sightings) -> dict[str, float]:
    """The figures of one deployment and one detector.

    Of a rig a frame is a moment with the images of all its cameras: `predicted_<n>`, `detected_<n>` and `agreement_<n>`
    count what any of them has, and the pose is of the body; single tags count once for each camera.

    `predicted_<n>`, `detected_<n>`: P(>= n), each with its standard error `_error`; `agreement_<n>`, the share of
    frames in which both agree on it; `precision`, `recall` over tags; `left_out`, the tags detected in a frame and not
    predicted, and of these `left_out_<criterion>`, those that fail it (one may fail several); `overrated`, those
    predicted and not detected, of these `overrated_cut` by the border, and `overrated_overlapping` of those that are
    whole; `false_a_frame`; `corner_median`, `corner_90`, pixels; `pose_share`, the share of frames with a pose, and
    the quantiles of its errors, metres and rad.
    """
    part = prediction.parts[0]
    row: dict[str, float] = {"frames": len(prediction.poses), "tags": part.visible.shape[1]}
    row["overlapping"] = int(part.overlapping.sum())
    visible, detected = prediction.visible, seen.detected
    foreseen, found = _by_any(visible, prediction), _by_any(detected, prediction)
    for name, which in (("predicted", foreseen), ("detected", found)):
        shares = at_least(which)
        for n, share, error in zip(TAG_NUMBERS, *shares, strict=True):
            row[f"{name}_{n}"], row[f"{name}_{n}_error"] = float(share), float(error)
    row |= {f"agreement_{n}": agreement(foreseen, found, int(n)) for n in TAG_NUMBERS}
    precision, recall = precision_recall(visible, detected)
    row |= {"precision": float(precision), "recall": float(recall)}
    left_out, overrated = detected & ~visible, visible & ~detected
    row["left_out"] = int(left_out.sum())
    row |= {f"left_out_{name}": int((left_out & ~met).sum()) for name, met in prediction.met.items()}
    row["overrated"], row["overrated_cut"] = int(overrated.sum()), int((overrated & ~prediction.whole).sum())
    row["overrated_overlapping"] = int((overrated & prediction.whole & prediction.overlapping).sum())
    row["false_a_frame"] = float(seen.false.mean())
    row |= _quantiles("corner", corner_error(seen.corners, prediction.corners))
    cameras = [part.renderer.camera for part in prediction.parts]
    images = seen.corners.reshape(len(seen.corners), len(cameras), -1, 4, 2)
    known = prediction.mounted, part.renderer.room.corners
    poses = np.stack([body_from_corners(cameras, *known, list(moment)) for moment in images])
    position, attitude = pose_error(prediction.poses, poses)
    row["pose_share"] = float(np.isfinite(position).mean())
    return row | _quantiles("position", position) | _quantiles("attitude", attitude)


def repeated(seen: Sightings, again: Sightings, prediction: Predicted | None = None) -> dict[str, float]:
    """How much a detector agrees with itself on two looks: no prediction can agree with it much more.

    `repeated_<n>`, the share of frames in which both looks agree on at least n tags; `repeated_tags`, of the tags found
    at all the share that both found.

    Args:
        seen, again: the two looks.
        prediction: of the cameras, if they are those of a rig.
    """
    both, either = seen.detected & again.detected, seen.detected | again.detected
    share = float(both.sum() / either.sum()) if either.any() else np.nan
    one, other = (s.detected if prediction is None else _by_any(s.detected, prediction) for s in (seen, again))
    return {f"repeated_{n}": agreement(one, other, int(n)) for n in TAG_NUMBERS} | {"repeated_tags": share}


def _quantiles(name: str, values: FloatArray) -> dict[str, float]:
    """`QUANTILES` of the finite values, NaN without any."""
    known = values[np.isfinite(values)]
    return {f"{name}_{key}": float(np.quantile(known, q)) if known.size else np.nan for key, q in QUANTILES.items()}


def by_pitch(prediction: Predicted, seen: Sightings) -> pd.DataFrame:
    """Tags that are wholly in the image, by their pitch.

    Columns: `pitch_from`, `pitch_to` (pixels a module), `tags`, the shares `predicted` and `detected` of them, and
    `corner_median`, `corner_90` (pixels). Classes without a tag are left out.
    """
    return _by_class(prediction, seen, "pitch", prediction.pitch, PITCHES)


def by_incidence(prediction: Predicted, seen: Sightings) -> pd.DataFrame:
    """As `by_pitch`, by the angle from the tag's normal to the camera, `incidence_from` to `incidence_to` degrees."""
    return _by_class(prediction, seen, "incidence", prediction.incidence, INCIDENCES)


def _by_class(
    prediction: Predicted, seen: Sightings, name: str, values: FloatArray, bounds: FloatArray
) -> pd.DataFrame:
    """Tags that are wholly in the image, by the class that their `values` `(N, K)` are in."""
    error = corner_error(seen.corners, prediction.corners)
    place = np.searchsorted(bounds, values, side="right") - 1
    quantiles = quantiles_by(values, error, bounds, tuple(QUANTILES.values()))
    rows = []
    for b, corner in enumerate(quantiles):
        members = (place == b) & prediction.whole
        if members.any():
            span = {f"{name}_from": bounds[b], f"{name}_to": bounds[b + 1], "tags": int(members.sum())}
            shares = {"predicted": prediction.visible[members].mean(), "detected": seen.detected[members].mean()}
            rows.append(span | shares | {f"corner_{key}": q for key, q in zip(QUANTILES, corner, strict=True)})
    return pd.DataFrame(rows)


def by_place(prediction: Predicted, seen: Sightings) -> pd.DataFrame:
    """Tags that are wholly in an image, by where their centre is in it: a row for each part of the image that has any.

    Columns: `column`, `row` of the part, of `PLACES`; `tags`, and the shares `predicted` and `detected` of them.
    """
    cameras = [part.renderer.camera for part in prediction.parts]
    sizes = np.array([(camera.image_width, camera.image_height) for camera in cameras])
    centres = prediction.corners.mean(axis=2)
    share = centres / np.repeat(sizes, centres.shape[1] // len(cameras), axis=0)
    part = np.floor(np.nan_to_num(share, nan=-1.0) * PLACES).astype(int)
    rows = []
    for row in range(PLACES[1]):
        for column in range(PLACES[0]):
            members = (part == [column, row]).all(axis=-1) & prediction.whole
            if members.any():
                shares = {"predicted": prediction.visible[members].mean(), "detected": seen.detected[members].mean()}
                rows.append({"column": column, "row": row, "tags": int(members.sum()), **shares})
    return pd.DataFrame(rows)


def by_tag(prediction: Predicted, seen: Sightings) -> pd.DataFrame:
    """A row for each tag: `id`, `overlapping`, frames it was `predicted` and `detected` in, `precision`, `recall`.

    Of a rig, by any of its cameras.
    """
    part = prediction.parts[0]
    visible, detected = _by_any(prediction.visible, prediction), _by_any(seen.detected, prediction)
    precision, recall = precision_recall(visible, detected, axis=0)
    return pd.DataFrame({
        "id": part.renderer.room.ids,
        "overlapping": part.overlapping,
        "predicted": visible.sum(axis=0),
        "detected": detected.sum(axis=0),
        "precision": precision,
        "recall": recall,
    })  # fmt: skip


def to_markdown(table: pd.DataFrame) -> str:
    """`figures` as Markdown, one row for each deployment and detector.

    Args:
        table: with the columns `deployment` and `detector` before those of `figures`.
    """
    criteria = [c.removeprefix("left_out_") for c in table.columns if c.startswith("left_out_")]
    head = ["deployment", "detector", *(f"P(>= {n}) predicted / detected" for n in TAG_NUMBERS), "frames agree on >= 2"]
    head += ["precision / recall of tags", "false a frame", "corners: median / 90 % [px]", "frames with a pose"]
    head += ["position: median / 90 % [mm]"]
    blame = [
        "deployment",
        "detector",
        "detected, not predicted",
        *(escaped(f"of these fail {c.replace('_', ' ')}") for c in criteria),
    ]
    blame += ["predicted, not detected", "of these cut by the border", "of the others overlapping"]
    looks = ["detector with itself on >= 2", "tags found both times"] if "repeated_tags" in table else []
    rows, wrong = [], []
    for row in table.to_dict("records"):
        shares = [
            f"{row[f'predicted_{n}']:.3f} / {row[f'detected_{n}']:.3f} ± {row[f'detected_{n}_error']:.3f}"
            for n in TAG_NUMBERS
        ]
        names = [escaped(row["deployment"]), escaped(row["detector"])]
        rows.append([
            *names,
            *shares,
            f"{row['agreement_2']:.1%}",
            f"{row['precision']:.3f} / {row['recall']:.3f}",
            f"{row['false_a_frame']:.3f}",
            f"{row['corner_median']:.2f} / {row['corner_90']:.2f}",
            f"{row['pose_share']:.1%}",
            f"{1e3 * row['position_median']:.2f} / {1e3 * row['position_90']:.2f}",
            *([f"{row['repeated_2']:.1%}", f"{row['repeated_tags']:.1%}"] if looks else []),
        ])  # fmt: skip
        counts = ["left_out", *(f"left_out_{c}" for c in criteria), "overrated", "overrated_cut"]
        wrong.append([*names, *(f"{row[key]:,.0f}" for key in (*counts, "overrated_overlapping"))])
    return f"{markdown_table([*head, *looks], rows)}\n\n{markdown_table(blame, wrong)}\n"
