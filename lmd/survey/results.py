"""Tables, metrics, the JSON document and the text of a survey."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lmd.adjust.gauge import twists_between
from lmd.adjust.tables import (
    TWISTS,
    a_few,
    both,
    clock_figures,
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
TURNS = ("a quarter turn clockwise", "half a turn", "a quarter turn counter-clockwise")


def _tags(poses: FloatArray, ids: IntArray, counts: IntArray, edges: FloatArray) -> Deployment:
    """Deployment of tags with given poses, ids and edge lengths. `counts` has the number of inliers of each tag."""
    labels = Labels(ids, {SIGHTINGS: [str(count) for count in counts.tolist()]})
    places = poses[:, :3, 3]
    surveyed = Surveyed(places, places, poses[:, :3, 1])
    return Deployment(places, poses[:, :3, 2], labels=labels, surveyed=surveyed, edges=edges)


def map_of(survey: Survey) -> Deployment:
    """Tags of the map at their estimated poses, with their edge lengths and numbers of inliers."""
    found, chosen = survey.found, survey.placed
    edges = np.array([float(f"{edge:.6g}") for edge in found.sightings.present_edges[chosen]])
    return _tags(found.poses.tags[chosen], survey.ids[chosen], survey.used[chosen], edges)


def measured_of(survey: Survey) -> Deployment | None:
    """Deployment with the tags of the plan, in the order of the plan; None without a plan. Tags that the survey placed
    have their measured poses, other tags their planned poses.
    """
    if (plan := survey.known.plan) is None:
        return None
    found, counts = map_of(survey), survey.used[np.searchsorted(survey.ids, plan.ids)]
    _, own, there = np.intersect1d(plan.ids, found.ids, return_indices=True)
    poses, edges = poses_of(plan), plan.edges.copy()
    poses[own], edges[own] = poses_of(found)[there], found.edges[there]
    return _tags(poses, plan.ids, counts, edges)


def map_columns(survey: Survey) -> dict[str, ArrayLike]:
    """Columns of `map.csv`: ids, poses, edge lengths, numbers of inliers, `sigma` and covariances of the tags. `sigma`
    is the standard deviation of the position relative to the other tags, metres. The covariances are those of
    positions, m^2, and rotations, rad^2, in the world frame.
    """
    tags, found, placed = map_of(survey), survey.found, survey.placed
    vectors = np.hstack([tags.places, tags.normals, tags.ups])
    return {
        ID: tags.ids,
        **dict(zip((*COLUMNS, *UP_COLUMNS), vectors.T, strict=True)),
        EDGE: tags.edges,
        SIGHTINGS: survey.used[placed],
        "sigma": found.sigmas[placed],
        **covariance_columns(found.poses.tags[placed], found.covariances[placed]),
    }


def map_covariance(survey: Survey) -> tuple[IntArray, FloatArray, FloatArray]:
    """Ids `(n,)`, positions, metres, `(n, 3)`, and joint covariance `(6 n, 6 n)` of the tags of `map.csv`. The
    covariance is that of the twists of these tags relative to each other.
    """
    found = survey.found
    chosen = survey.placed[found.known]
    rows = np.flatnonzero(np.repeat(chosen, 6))
    ids, positions = survey.ids[found.known][chosen], found.poses.tags[found.known][chosen][:, :3, 3]
    return ids, positions, found.gauge_free_covariance[np.ix_(rows, rows)]


def frame_columns(survey: Survey) -> dict[str, ArrayLike]:
    """Columns of `frames.csv`: for each frame of the map, time, pose of the body (first camera) and number of inliers.

    Quaternions rotate the camera's frame (x right, y down, z the optical axis) to the world frame.
    """
    found, used = survey.found, survey.found.frames
    counts = np.bincount(found.sightings.frame[found.used], minlength=found.sightings.frames)
    times = [survey.detected.times[frame] for frame in used.tolist()]
    return {"time": times, **pose_columns(found.poses.frames[used]), "tags": counts[used]}


def tag_columns(survey: Survey) -> dict[str, ArrayLike]:
    """Columns of the table of all tags: state, numbers of sightings, and displacement from the planned pose. The state
    is `placed`, or the reason why the tag is not in the map.

    The displacement has the columns `right`, `up` and `out`, metres in the tag's frame, and `tilt_x`, `tilt_y` and
    `turn`, rad about the axes of this frame. The column `sigma` is the standard deviation of the position relative to
    the other tags, in the worst direction, metres.
    """
    found, some, placed = survey.found, survey.found.sightings, survey.placed
    seen = some.counts()
    moved = np.where(placed[:, None], twists_between(survey.known.planned(survey.ids), found.poses.tags), np.nan)
    groups = [f"in group {group}" for group in found.group.tolist()]
    states = [placed, seen == 0, survey.loose, found.group > 0, seen == 1]
    return {
        ID: survey.ids,
        "state": np.select(states, ["placed", "not seen", "hardly known", groups, "seen once"], "not placed"),
        "seen": seen,
        SIGHTINGS: survey.used,
        "misfits": some.counts(found.misfits),
        "sigma": np.where(placed, found.sigmas, np.nan),
        **dict(zip(TWISTS, moved.T, strict=True)),
    }


def distances_from_plan(survey: Survey) -> FloatArray:
    """Distance of each tag of the map from its planned position, metres, `(K,)`; NaN for tags that are not in
    the plan.
    """
    away = np.linalg.norm((survey.found.poses.tags - survey.known.planned(survey.ids))[:, :3, 3], axis=1)
    return np.where(survey.placed, away, np.nan)


def metrics(survey: Survey) -> dict[str, float]:
    """Metrics of the survey, keyed by name: lengths in metres, errors in pixels, counts."""
    found, placed, out = survey.found, survey.placed, survey.held_out
    return {
        "tags": float(placed.sum()),
        "frames": float(len(found.frames)),
        "misfits": float(found.misfits.sum()),
        "tag_shape": found.sightings.shape_sigma,
        **figures_of(found),
        **clock_figures(found),
        **quantiles("sigma", found.sigmas[placed]),
        **quantiles("moved", distances_from_plan(survey)),
        **(quantiles("held_out_error", out.errors) | quantiles("held_out_shift", out.shifts) if out else {}),
    }


def survey_document(survey: Survey) -> dict[str, Any]:
    """Content of the file `survey.json`: metrics, doubts (sentences for the user), cameras, motion, and a row for each
    tag.
    """
    found, ids, columns, motion = survey.found, survey.ids, tag_columns(survey), survey.found.prior.motion
    return {
        "figures": metrics(survey),
        "interrupted": None if survey.interrupted is None else survey.interrupted.value,
        "doubts": list(survey.doubts),
        "cameras": dict(zip(survey.detected.cameras, found.poses.mounts.tolist(), strict=True)),
        "motion": motion and {"turn": motion.spread[0], "place": motion.spread[1]},
        "second_places": {int(ids[one.tag]): one.pose.tolist() for one in survey.faults.second_places},
        "tags": [dict(zip(columns, row, strict=True)) for row in zip(*map(plain, columns.values()), strict=True)],
        **document_of(found, survey.detected, survey.faults.sizes),
    }


def to_text(survey: Survey) -> str:
    """Text for a terminal; lines that need attention come last."""
    figures, found, ids, placed = metrics(survey), survey.found, survey.ids, survey.placed
    expected = placed | survey.loose | np.isin(ids, survey.known.ids)
    lines = {
        "tags": f"{placed.sum()} of {expected.sum()} placed",
        "frames": f"{len(found.frames)} of {len(survey.detected.times)}, with {found.used.sum()} sightings",
        "known to": f"{both(figures, 'sigma')} mm relative to each other, one standard deviation",
    }
    if survey.detected.left_out:
        lines["frames"] += f"; {len(survey.detected.left_out)} were left out (survey.every)"
    if (motion := found.prior.motion) is not None:
        turn, place = (1e3 * spread for spread in motion.spread)
        lines["motion"] = f"the velocity changes by {place:.2g} mm/s and {turn:.2g} mrad/s within a second"
        if motion.odometry is not None:
            lines["motion"] = f"odometry drifts {place:.2g} mm and {turn:.2g} mrad within a metre"
        lines["motion"] += f"; it joins {survey.joined.max() + 1} groups of tags" * bool(survey.joined.max() > 0)
    if "moved/50" in figures:
        away = np.nan_to_num(1e3 * distances_from_plan(survey))
        lines["they hang"] = f"{both(figures, 'moved', digits='.3g')} mm off their plan; "
        lines["they hang"] += f"farthest: {ids[away.argmax()]} ({away.max():.3g} mm)"
    if survey.held_out is not None:
        off = both(figures, "held_out_error", 1.0)
        lines["held out"] = (
            f"{len(survey.held_out.shifts)} frames: corners {off} pixels off by a map made from the others"
        )
    if survey.interrupted is not None:
        lines["interrupted"] = f"while {survey.interrupted.value}: the map is not final, or later steps are missing"
    states = np.asarray(tag_columns(survey)["state"])
    lines |= {str(state): a_few(ids[states == state]) for state in np.unique(states) if state != "placed"}
    lines |= lines_of(found, survey.detected, survey.faults.sizes, survey.doubts)
    return labelled(lines | {label: text for label, text in _troubles(survey).items() if text})


def _troubles(survey: Survey) -> dict[str, str]:
    """Texts about faulty tags, keyed by kind of fault, such as `moved`; the text is empty if no tag has the fault."""
    ids, found, faults, shown = survey.ids, survey.found, survey.faults, survey.found.sightings.counts() > 0
    unplanned = survey.placed & ~np.isin(ids, survey.known.ids) & (survey.known.plan is not None)
    moved = [(ids[one.tag], one.moved) for one in faults.second_places]
    turned = [
        f"{words}: {a_few(ids[own])}; {made}"
        for made, by in zip(
            ("their corners are renumbered", "the map has them as they hang"), survey.turns, strict=True
        )
        for quarters, words in enumerate(TURNS, 1)
        if (own := (by == quarters) & shown).any()
    ]
    return {
        "turned": ". ".join(turned),
        "fixed": a_few(
            f"{tag} hangs elsewhere in the photographs" for tag in ids[found.prior.exact & found.are_astray]
        ),
        "not planned": a_few(ids[unplanned]),
        "moved": a_few(f"{tag} from {survey.detected.times[at]} on" for tag, at in moved if at is not None),
        "twice": a_few(tag for tag, at in moved if at is None),
        "misread": a_few(f"{ids[k]} ({faults.misread[k]} x)" for k in np.flatnonzero(faults.misread)),
    }
