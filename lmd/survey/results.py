"""Tables, figures and the JSON document of a survey; `lmd.survey.terminal` has its text."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lmd.adjust.gauge import SIGMA_COLUMNS, TWISTS, covariance_columns, quantiles
from lmd.core.checks import FloatArray, IntArray
from lmd.geometry.se3 import ROW, inverse, log
from lmd.scene.deployment import COLUMNS, UP_COLUMNS, Deployment
from lmd.scene.labels import EDGE, ID, Labels, Surveyed
from lmd.survey.survey import Survey

SIGHTINGS = "sightings"  # column of the number of inliers of a tag
# A tag of the map needs another photograph if it has fewer inliers than `FEW`, or a sigma above `LOOSE` times the
# median.
FEW, LOOSE = 3, 3.0
# A tag is far from its plan if its distance exceeds `FAR` times the median distance, and `FAR_SIGMAS` assumed standard
# deviations.
FAR, FAR_SIGMAS = 5.0, 3.0


def map_of(survey: Survey) -> Deployment:
    """Tags of the map as they hang, with their edges and numbers of inliers."""
    found, chosen = survey.found, np.flatnonzero(survey.placed)
    edges = np.array([float(f"{edge:.6g}") for edge in found.sightings.present_edges[chosen]])
    labels = Labels(survey.ids[chosen], {SIGHTINGS: [str(count) for count in survey.used[chosen]]})
    poses = found.poses.tags[chosen]
    places = poses[:, :3, 3]
    surveyed = Surveyed(places, places, poses[:, :3, 1])
    return Deployment(places, poses[:, :3, 2], labels=labels, surveyed=surveyed, edges=edges)


def measured_of(survey: Survey) -> Deployment | None:
    """Tags of the plan, in its order, at their measured poses, or at their planned poses if not placed; None without a
    plan.
    """
    plan = survey.known.plan
    if plan is None:
        return None
    found = map_of(survey)
    index = {number: k for k, number in enumerate(found.ids.tolist())}
    own = np.array([index.get(number, -1) for number in plan.ids.tolist()])
    there = own >= 0

    def either(measured: FloatArray, planned: FloatArray) -> FloatArray:
        return np.where(there[:, None] if planned.ndim > 1 else there, measured[own], planned)

    places, ups = either(found.places, plan.places), either(found.ups, plan.ups)
    counts = survey.used[np.searchsorted(survey.ids, plan.ids)]
    labels = Labels(plan.ids, {SIGHTINGS: [str(count) for count in counts.tolist()]})
    normals = either(found.normals, plan.normals)
    edges = either(found.edges, plan.edges)
    return Deployment(places, normals, labels=labels, surveyed=Surveyed(places, places, ups), edges=edges)


def map_columns(survey: Survey) -> dict[str, ArrayLike]:
    """Columns of `map.csv`: tags; standard deviations beside the other tags, rad and metres, in the frames of the tags;
    covariances of positions, m^2, and rotations, rad^2, in the world frame.
    """
    tags = map_of(survey)
    vectors = np.hstack([tags.places, tags.normals, tags.ups])
    covariances = survey.found.in_world(survey.found.covariances)[survey.placed]
    squares = np.diagonal(survey.found.gauge_free_covariances[survey.placed], axis1=1, axis2=2)
    own = dict(zip(SIGMA_COLUMNS, np.sqrt(np.maximum(squares, 0.0)).T, strict=True))
    assert tags.labels is not None
    columns = {ID: tags.ids, **dict(zip((*COLUMNS, *UP_COLUMNS), vectors.T, strict=True)), EDGE: tags.edges}
    return {
        **columns,
        **tags.labels.columns,
        "sigma": survey.found.sigmas[survey.placed],
        **own,
        **covariance_columns(covariances),
    }


def map_covariance(survey: Survey) -> tuple[IntArray, FloatArray]:
    """Ids `(n,)`, and covariance `(6 n, 6 n)` of their twists beside the other tags, of the tags of `map.csv`."""
    found = survey.found
    chosen = survey.placed[found.known]
    rows = np.flatnonzero(np.repeat(chosen, 6))
    return survey.ids[found.known][chosen], found.gauge_free_covariance[np.ix_(rows, rows)]


def frame_columns(survey: Survey) -> dict[str, ArrayLike]:
    """Columns of `frames.csv`: pose of the body, which is the first camera, in each frame, and number of tags in the
    frame.

    Quaternions rotate the camera's frame (x right, y down, z the optical axis) to the world frame.
    """
    from scipy.spatial.transform import Rotation

    found, used = survey.found, survey.found.frames
    poses = found.poses.frames[used]
    turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)
    rows = np.hstack([poses[:, :3, 3], turns])
    counts = np.bincount(found.sightings.frame[found.used], minlength=found.sightings.frames)
    times = [survey.detected.times[frame] for frame in used.tolist()]
    return {"time": times, **dict(zip(ROW, rows.T, strict=True)), "tags": counts[used]}


def tag_columns(survey: Survey) -> dict[str, ArrayLike]:
    """State of every tag, its numbers of sightings, errors, and displacement from its plan.

    `error` is the median of the tag's reprojection errors, pixels; for `sigma` see `Estimate.sigmas`; `right`, `up` and
    `out` are metres in the tag's frame, `tilt_x`, `tilt_y` and `turn` rad about its axes.
    """
    found, owner = survey.found, survey.found.sightings.tag
    error = np.sqrt(found.squares / 4.0)
    own = [error[found.used & (owner == k)] for k in range(len(survey.ids))]
    moved = np.full((len(survey.ids), 6), np.nan)
    if (planned := survey.planned) is not None:
        both = survey.placed & np.isfinite(planned[:, 0, 0])
        moved[both] = log(inverse(planned[both]) @ found.poses.tags[both])
    return {
        ID: survey.ids,
        "state": [_tag_state(survey, k) for k in range(len(survey.ids))],
        "seen": found.sightings.counts(),
        SIGHTINGS: survey.used,
        "misfits": found.sightings.counts(found.misfits),
        "error": [np.median(errors) if errors.size else np.nan for errors in own],
        "sigma": np.where(survey.placed, found.sigmas, np.nan),
        **dict(zip(TWISTS, moved.T, strict=True)),
    }


def _tag_state(survey: Survey, k: int) -> str:
    """State of the tag of index k, in words."""
    if survey.placed[k]:
        return "placed"
    seen = np.count_nonzero(survey.found.sightings.tag == k)
    if not seen:
        return "not seen"
    if survey.known.plan is not None and survey.ids[k] not in survey.known.ids:
        return "not believed"
    if survey.loose[k]:
        return "hardly known"
    if survey.found.group[k] > 0:
        return f"in group {survey.found.group[k]}"
    return "seen once" if seen == 1 else "not placed"


def distances_from_plan(survey: Survey) -> FloatArray:
    """Distance of each tag of the map from its planned place, metres, `(K,)`; NaN for tags without a plan."""
    if survey.planned is None:
        return np.full(len(survey.ids), np.nan)
    away = np.linalg.norm((survey.found.poses.tags - survey.planned)[:, :3, 3], axis=1)
    return np.where(survey.placed, away, np.nan)


def far_from_plan(survey: Survey) -> IntArray:
    """Indices of the tags that hang much farther from their plan than most tags and than is assumed, farthest first."""
    away = distances_from_plan(survey)
    if np.isnan(away).all():
        return np.empty(0, dtype=np.int64)
    least = max(FAR * float(np.nanmedian(away)), FAR_SIGMAS * survey.known.hanging.place)
    far = np.flatnonzero(away > least)
    return far[np.argsort(-away[far])]


def needing_photographs(survey: Survey) -> IntArray:
    """Indices of the tags that need another photograph: tags not placed, tags with few inliers, and tags with a large
    sigma.
    """
    sigma = survey.found.sigmas
    known = sigma[survey.placed]
    loose = sigma > LOOSE * np.median(known) if known.size else np.zeros(len(sigma), dtype=bool)
    expected = np.isin(survey.ids, survey.known.ids) | survey.placed
    return np.flatnonzero(expected & (~survey.placed | (survey.used < FEW) | loose))


def metrics(survey: Survey) -> dict[str, float]:
    """Figures by name: metres, pixels, counts.

    `differs` is the expected median distance between the places of a tag in two maps from walks like this walk.
    """
    found = survey.found
    square = 2.0 * np.trace(found.gauge_free_covariances[survey.placed][:, 3:, 3:], axis1=1, axis2=2)
    figures = {
        "tags": float(survey.placed.sum()),
        "frames": float(len(found.frames)),
        SIGHTINGS: float(found.used.sum()),
        "misfits": float(found.misfits.sum()),
        "corner_floor": found.floor,
        "tag_shape": found.sightings.shape_sigma,
        "inflation": found.inflation,
        "differs": float(np.sqrt(np.median(square))) if square.size else np.nan,
        **quantiles("sigma", found.sigmas[survey.placed]),
        **quantiles("error", found.errors()),
    }
    away = distances_from_plan(survey)
    figures |= quantiles("moved", away[np.isfinite(away)])
    for name, frames in survey.localised.items():
        figures |= quantiles(f"held_out_error_{name}", frames.errors)
        figures |= quantiles(f"held_out_shift_{name}", frames.shifts)
    return {name: value for name, value in figures.items() if np.isfinite(value)}


def survey_document(survey: Survey) -> dict[str, Any]:
    """Content of `survey.json`."""
    found, ids, times, columns = survey.found, survey.ids, survey.detected.times, tag_columns(survey)
    return {
        "figures": metrics(survey),
        "interrupted": None if survey.interrupted is None else survey.interrupted.value,
        "doubts": list(survey.doubts),
        "frames": len(times),
        "blurred": dict(survey.detected.blurred),
        "copies": dict(survey.detected.copies),
        "left_out": list(survey.detected.left_out),
        "used_frames": [times[frame] for frame in found.frames.tolist()],
        "cameras": dict(zip(survey.detected.cameras, found.poses.mounts.tolist(), strict=True)),
        "intrinsics": [camera.document() for camera in survey.calibrated],
        "motion": _motion_document(survey),
        "groups": [ids[found.group == g].tolist() for g in range(1, found.group.max(initial=0) + 1)],
        "another_photograph": ids[needing_photographs(survey)].tolist(),
        "second_places": [
            {
                ID: int(ids[place.tag]),
                "pose": place.pose.tolist(),
                SIGHTINGS: place.sightings,
                "moved_from": None if place.moved is None else times[place.moved],
                "later": place.later,
            }
            for place in survey.faults.second_places
        ],
        "sizes": {str(ids[tag]): edge for tag, edge in survey.faults.sizes.items()},
        "misread": {str(ids[k]): int(survey.faults.misread[k]) for k in np.flatnonzero(survey.faults.misread)},
        "tags": [dict(zip(columns, row, strict=True)) for row in zip(*map(_plain, columns.values()), strict=True)],
    }


def _motion_document(survey: Survey) -> dict[str, Any] | None:
    """Entry of `survey.json` on the motion between frames; None without."""
    motion, joined = survey.found.prior.motion, survey.joined
    if motion is None:
        return None
    turn, place = motion.spread
    groups = joined.group if joined is not None else np.full(len(survey.ids), -1)
    return {
        "by": "odometry" if motion.is_odometry else "constant velocity",
        "turn": turn,
        "place": place,
        "longest": None if motion.is_odometry else motion.longest,
        "joined": [survey.ids[groups == g].tolist() for g in range(groups.max(initial=-1) + 1)],
        "sigma": [] if joined is None else joined.sigma.tolist(),
    }


def _plain(values: ArrayLike) -> list[Any]:
    """Values for JSON: null for NaN."""
    return [None if value != value else value for value in np.asarray(values).tolist()]
