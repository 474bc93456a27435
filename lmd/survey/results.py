"""Tables, figures, the JSON document and the text of a survey."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lmd.adjust.gauge import twists_between
from lmd.adjust.tables import (
    SIGMA_COLUMNS,
    TWISTS,
    a_few,
    both,
    covariance_columns,
    document_of,
    figures_of,
    lines_of,
    plain,
    pose_columns,
    quantiles,
)
from lmd.core.checks import FloatArray, IntArray
from lmd.core.words import labelled
from lmd.scene.deployment import COLUMNS, UP_COLUMNS, Deployment, poses_of
from lmd.scene.labels import EDGE, ID, Labels, Surveyed
from lmd.survey.survey import Survey

SIGHTINGS = "sightings"  # column of the number of inliers of a tag
# A tag of the map needs another photograph if it has fewer inliers than `FEW`, or a sigma above `LOOSE` times the
# median.
FEW, LOOSE = 3, 3.0
# A tag is far from its plan if its distance exceeds `FAR` times the median distance, and `FAR_SIGMAS` assumed standard
# deviations.
FAR, FAR_SIGMAS = 5.0, 3.0
TURNS = ("a quarter turn clockwise", "half a turn", "a quarter turn counter-clockwise")


def _tags(poses: FloatArray, ids: IntArray, counts: IntArray, edges: FloatArray) -> Deployment:
    """Deployment of tags at `poses`, with their numbers of inliers."""
    labels = Labels(ids, {SIGHTINGS: [str(count) for count in counts.tolist()]})
    places = poses[:, :3, 3]
    surveyed = Surveyed(places, places, poses[:, :3, 1])
    return Deployment(places, poses[:, :3, 2], labels=labels, surveyed=surveyed, edges=edges)


def map_of(survey: Survey) -> Deployment:
    """Tags of the map at their estimated poses, with their edges and numbers of inliers."""
    found, chosen = survey.found, survey.placed
    edges = np.array([float(f"{edge:.6g}") for edge in found.sightings.present_edges[chosen]])
    return _tags(found.poses.tags[chosen], survey.ids[chosen], survey.used[chosen], edges)


def measured_of(survey: Survey) -> Deployment | None:
    """Tags of the plan, in the order of the plan: at the measured poses or, if not placed, at the planned poses. None
    without a plan.
    """
    if (plan := survey.known.plan) is None:
        return None
    found, counts = map_of(survey), survey.used[np.searchsorted(survey.ids, plan.ids)]
    _, own, there = np.intersect1d(plan.ids, found.ids, return_indices=True)
    poses, edges = poses_of(plan), plan.edges.copy()
    poses[own], edges[own] = poses_of(found)[there], found.edges[there]
    return _tags(poses, plan.ids, counts, edges)


def map_columns(survey: Survey) -> dict[str, ArrayLike]:
    """Columns of `map.csv`: tags; standard deviations relative to the other tags, rad and metres, in the frames of the
    tags; covariances of positions, m^2, and rotations, rad^2, in the world frame.
    """
    tags, found, placed = map_of(survey), survey.found, survey.placed
    vectors = np.hstack([tags.places, tags.normals, tags.ups])
    squares = np.diagonal(found.gauge_free_covariances[placed], axis1=1, axis2=2)
    return {
        ID: tags.ids,
        **dict(zip((*COLUMNS, *UP_COLUMNS), vectors.T, strict=True)),
        EDGE: tags.edges,
        SIGHTINGS: survey.used[placed],
        "sigma": found.sigmas[placed],
        **dict(zip(SIGMA_COLUMNS, np.sqrt(np.maximum(squares, 0.0)).T, strict=True)),
        **covariance_columns(found.poses.tags[placed], found.covariances[placed]),
    }


def map_covariance(survey: Survey) -> tuple[IntArray, FloatArray]:
    """Ids of the tags of `map.csv`, `(n,)`, and the covariance of their twists relative to the other tags, `(6 n, 6
    n)`.
    """
    found = survey.found
    chosen = survey.placed[found.known]
    rows = np.flatnonzero(np.repeat(chosen, 6))
    return survey.ids[found.known][chosen], found.gauge_free_covariance[np.ix_(rows, rows)]


def frame_columns(survey: Survey) -> dict[str, ArrayLike]:
    """Columns of `frames.csv`: for each frame, the pose of the body, which is the first camera, and the number of tags.

    Quaternions rotate the camera's frame (x right, y down, z the optical axis) to the world frame.
    """
    found, used = survey.found, survey.found.frames
    counts = np.bincount(found.sightings.frame[found.used], minlength=found.sightings.frames)
    times = [survey.detected.times[frame] for frame in used.tolist()]
    return {"time": times, **pose_columns(found.poses.frames[used]), "tags": counts[used]}


def tag_columns(survey: Survey) -> dict[str, ArrayLike]:
    """Columns for every tag: state, numbers of sightings, errors, and displacement from the planned pose.

    `error` is the median of the tag's reprojection errors, pixels; for `sigma` see `Estimate.sigmas`; `right`, `up` and
    `out` are metres in the tag's frame, `tilt_x`, `tilt_y` and `turn` rad about its axes.
    """
    found, some, placed = survey.found, survey.found.sightings, survey.placed
    seen, error = some.counts(), np.where(found.used, np.sqrt(found.squares / 4.0), np.nan)
    own = [error[found.used & (some.tag == k)] for k in range(len(survey.ids))]
    moved = np.where(placed[:, None], twists_between(survey.planned, found.poses.tags), np.nan)
    groups = [f"in group {group}" for group in found.group.tolist()]
    states = [placed, seen == 0, survey.loose, found.group > 0, seen == 1]
    return {
        ID: survey.ids,
        "state": np.select(states, ["placed", "not seen", "hardly known", groups, "seen once"], "not placed"),
        "seen": seen,
        SIGHTINGS: survey.used,
        "misfits": some.counts(found.misfits),
        "misread": survey.faults.misread,
        "error": [np.median(errors) if errors.size else np.nan for errors in own],
        "sigma": np.where(placed, found.sigmas, np.nan),
        **dict(zip(TWISTS, moved.T, strict=True)),
    }


def distances_from_plan(survey: Survey) -> FloatArray:
    """Distance of each tag of the map from its planned place, metres, `(K,)`; NaN for tags without a plan."""
    away = np.linalg.norm((survey.found.poses.tags - survey.planned)[:, :3, 3], axis=1)
    return np.where(survey.placed, away, np.nan)


def far_from_plan(survey: Survey) -> IntArray:
    """Indices of the tags that hang much farther from their plan than most tags and than is assumed, farthest first."""
    away = distances_from_plan(survey)
    most = FAR * float(np.median(away[np.isfinite(away)])) if np.isfinite(away).any() else np.inf
    far = np.flatnonzero(away > max(most, FAR_SIGMAS * survey.known.hanging.place))
    return far[np.argsort(-away[far])]


def needing_photographs(survey: Survey) -> IntArray:
    """Indices of the tags that need another photograph: tags that are not placed, have few inliers, or have a large
    sigma.
    """
    sigma, placed = survey.found.sigmas, survey.placed
    loose = sigma > LOOSE * np.median(sigma[placed])
    expected = np.isin(survey.ids, survey.known.ids) | placed
    return np.flatnonzero(expected & (~placed | (survey.used < FEW) | loose))


def metrics(survey: Survey) -> dict[str, float]:
    """Figures by name: metres, pixels, counts.

    `differs` is the expected median distance between the positions of a tag in two maps from repeated, similar walks.
    """
    found, placed = survey.found, survey.placed
    square = 2.0 * np.trace(found.gauge_free_covariances[placed][:, 3:, 3:], axis1=1, axis2=2)
    figures = {
        "tags": float(placed.sum()),
        "frames": float(len(found.frames)),
        "misfits": float(found.misfits.sum()),
        "tag_shape": found.sightings.shape_sigma,
        "differs": float(np.sqrt(np.median(square))),
        **figures_of(found),
        **quantiles("sigma", found.sigmas[placed]),
        **quantiles("moved", distances_from_plan(survey)),
    }
    for name, frames in survey.localised.items():
        figures |= quantiles(f"held_out_error_{name}", frames.errors)
        figures |= quantiles(f"held_out_shift_{name}", frames.shifts)
    return figures


def survey_document(survey: Survey) -> dict[str, Any]:
    """Content of `survey.json`."""
    found, ids, times, columns = survey.found, survey.ids, survey.detected.times, tag_columns(survey)
    motion, joined = found.prior.motion, [ids[survey.joined == g].tolist() for g in range(survey.joined.max() + 1)]
    return {
        "figures": metrics(survey),
        "interrupted": None if survey.interrupted is None else survey.interrupted.value,
        "doubts": list(survey.doubts),
        "cameras": dict(zip(survey.detected.cameras, found.poses.mounts.tolist(), strict=True)),
        "motion": None
        if motion is None
        else {
            "by": "odometry" if motion.is_odometry else "constant velocity",
            "turn": motion.spread[0],
            "place": motion.spread[1],
            "longest": None if motion.is_odometry else motion.longest,
            "joined": joined,
        },
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
        "tags": [dict(zip(columns, row, strict=True)) for row in zip(*map(plain, columns.values()), strict=True)],
        **document_of(found.calibrated, survey.detected, survey.faults.sizes),
    }


def to_text(survey: Survey) -> str:
    """Lines for a terminal; those that need attention come last."""
    figures, found, ids, placed = metrics(survey), survey.found, survey.ids, survey.placed
    expected = placed | survey.loose | np.isin(ids, survey.known.ids)
    sigma = f"{both(figures, 'sigma')} mm relative to each other, one standard deviation"
    lines = {
        "tags": f"{placed.sum()} of {expected.sum()} placed",
        "frames": f"{len(found.frames)} of {len(survey.detected.times)}, with {found.used.sum()} sightings",
        "known to": f"{sigma}; a map of another such walk would differ by {1e3 * figures['differs']:.2g} mm (median)",
    }
    if survey.detected.left_out:
        lines["frames"] += f"; {len(survey.detected.left_out)} were left out (survey.every)"
    if (motion := found.prior.motion) is not None:
        turn, place = (1e3 * spread for spread in motion.spread)
        if motion.is_odometry:
            lines["odometry"] = f"drifts {place:.2g} mm and {turn:.2g} mrad within a metre, as estimated from the drive"
        else:
            lines["motion"] = f"the velocity changes by {place:.2g} mm/s and {turn:.2g} mrad/s within a second, as "
            lines["motion"] += f"estimated from the drive; frames up to {motion.longest:.2g} s apart are linked"
        if (count := len(np.unique(survey.joined[survey.joined >= 0]))) > 1:
            lines["joined"] = f"{count} groups of tags that no image connects, by motion alone"
    if "moved/50" in figures:
        lines["they hang"] = f"{both(figures, 'moved', digits='.3g')} mm off their plan"
        away = 1e3 * distances_from_plan(survey)
        if far := [f"{ids[k]} ({away[k]:.3g} mm)" for k in far_from_plan(survey)]:
            lines["they hang"] += f"; farthest: {a_few(far)}: check the plan there"
    for number, camera in enumerate(found.calibrated, 1):
        if not camera.is_fixed:
            label = "not fixed" + f" {number}" * (len(found.calibrated) > 1)
            lines[label] = "the camera: photograph tags on several walls at once, also held upright"
    if "measured" in survey.localised:
        lines["held out"] = f"{len(survey.localised['measured'].shifts)} frames: corners "
        lines["held out"] += f"{both(figures, 'held_out_error_measured', 1.0)} pixels off by a map made from the others"
    if "planned" in survey.localised:
        lines["planned"] = (
            f"by the planned map {both(figures, 'held_out_error_planned', 1.0)} pixels off, and the camera"
        )
        lines["planned"] += f" {both(figures, 'held_out_shift_planned', digits='.3g')} mm elsewhere"
    if (stage := survey.interrupted) is not None:
        lines["interrupted"] = f"told to stop while {stage.value}; " + (
            "what comes after that is left out" if stage.has_final_map else "the map is not final"
        )
    states = np.asarray(tag_columns(survey)["state"])
    lines |= {str(state): a_few(ids[states == state]) for state in np.unique(states) if state != "placed"}
    lines |= lines_of(found, found.calibrated, survey.detected, survey.faults.sizes, survey.doubts)
    return labelled(lines | {label: text for label, text in _troubles(survey).items() if text})


def _troubles(survey: Survey) -> dict[str, str]:
    """Sentences on faults and on missing photographs, by kind of trouble; empty for kinds that do not occur."""
    ids, times, faults, sigma = survey.ids, survey.detected.times, survey.faults, survey.found.sigmas
    unplanned = survey.placed & ~np.isin(ids, survey.known.ids) & (survey.known.plan is not None)
    worst = [f"{ids[k]} ({1e3 * sigma[k]:.2g} mm)" for k in needing_photographs(survey) if survey.placed[k]]
    moved = [place for place in faults.second_places if place.moved is not None]
    off = [
        f"{number} ({f'{1e3 * metres:.2g} mm' if metres == metres else f'{np.degrees(rad):.2g} degrees'})"
        for number, (metres, rad) in zip(ids, survey.off_fixed, strict=True)
        if metres == metres or rad == rad
    ]
    asked = "; elsewhere in the photographs: check the file, and each edge"
    return {
        "turned": _turned(survey),
        "fixed": a_few(off) + asked * bool(off),
        "not planned": a_few(ids[unplanned]),
        "moved": a_few(f"{ids[place.tag]} from {times[place.moved or 0]} on" for place in moved),
        "twice": a_few(ids[place.tag] for place in faults.second_places if place.moved is None),
        "misread": a_few(f"{ids[k]} ({faults.misread[k]} x)" for k in np.flatnonzero(faults.misread)),
        "photograph": a_few(worst) + "; known worst" * bool(worst),
    }


def _turned(survey: Survey) -> str:
    """Tags that are turned relative to their plan, with a sentence on the treatment of the turns."""
    turns, shown = survey.turns, survey.found.sightings.counts() > 0
    hung = np.where(turns.beside_plan, turns.beside_plan, turns.beside_sheets)
    return ". ".join(
        f"{words}: {a_few(survey.ids[own])}; {made}"
        for made, by in (("their corners are renumbered", turns.renumbered), ("the map has them as they hang", hung))
        for quarters, words in enumerate(TURNS, 1)
        if (own := (by == quarters) & shown).any()
    )
