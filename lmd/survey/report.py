"""What a survey found, as tables and in words."""

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lmd.core.checks import FloatArray, IntArray
from lmd.core.words import few
from lmd.geometry.se3 import ROW, inverse, log
from lmd.scene.deployment import COLUMNS, UP_COLUMNS, Deployment
from lmd.scene.edges import EDGE, with_gaps
from lmd.scene.labels import ID, Labels
from lmd.scene.surveyed import Surveyed
from lmd.survey.residuals import errors_at
from lmd.survey.survey import Survey

SIGHTINGS = "sightings"  # the column that says how many place a tag
AXES = ("x", "y", "z", "rx", "ry", "rz")
# A tag of the map needs another photograph if fewer sightings place it, or it is so many times worse known than most.
FEW, LOOSE = 3, 3.0
NOTICED = 0.01  # pixels
TURNS = ("a quarter turn clockwise", "half a turn", "a quarter turn counter-clockwise")
_few = partial(few, most=12)  # tags that a terminal names


def map_of(survey: Survey) -> Deployment:
    """The tags of the map as they hang, with the edge of each and how many sightings place it."""
    found, chosen = survey.found, np.flatnonzero(survey.placed)
    edges = np.array([float(f"{edge:.6g}") for edge in found.sightings.edges[chosen]])
    labels = Labels(survey.ids[chosen], {SIGHTINGS: [str(count) for count in survey.used[chosen]]})
    poses = found.poses.tags[chosen]
    places = poses[:, :3, 3]
    surveyed = Surveyed(places, places, poses[:, :3, 1])
    return Deployment(places, poses[:, :3, 2], labels=labels, surveyed=surveyed, edges=edges)


def measured_of(survey: Survey) -> Deployment | None:
    """The tags of the plan, in its order, as measured, or as planned if not placed; None without a plan."""
    plan = survey.known.plan
    if plan is None:
        return None
    found = map_of(survey)
    assert found.edges is not None
    place = {number: k for k, number in enumerate(found.ids.tolist())}
    own = np.array([place.get(number, -1) for number in plan.ids.tolist()])
    there = own >= 0

    def either(measured: FloatArray, planned: FloatArray) -> FloatArray:
        return np.where(there[:, None] if planned.ndim > 1 else there, measured[own], planned)

    places, ups = either(found.places, plan.places), either(found.ups, plan.ups)
    counts = survey.used[np.searchsorted(survey.ids, plan.ids)]
    labels = Labels(plan.ids, {SIGHTINGS: [str(count) for count in counts.tolist()]})
    normals = either(found.normals, plan.normals)
    edges = either(found.edges, with_gaps(plan.edges, len(plan)))
    return Deployment(places, normals, labels=labels, surveyed=Surveyed(places, places, ups), edges=edges)


def map_columns(survey: Survey) -> dict[str, ArrayLike]:
    """The columns of `map.csv`: tags, and covariances of their positions (m^2) and turns (rad^2) in the world frame."""
    tags = map_of(survey)
    vectors = np.hstack([tags.places, tags.normals, tags.ups])
    covariances = survey.found.in_world(survey.found.covariances)[survey.placed]
    upper = {f"cov_{AXES[i]}_{AXES[j]}": covariances[:, i, j] for i in range(len(AXES)) for j in range(i, len(AXES))}
    assert tags.labels is not None
    assert tags.edges is not None
    columns = {ID: tags.ids, **dict(zip((*COLUMNS, *UP_COLUMNS), vectors.T, strict=True)), EDGE: tags.edges}
    return {**columns, **tags.labels.columns, "sigma": sigmas(survey)[survey.placed], **upper}


def frame_columns(survey: Survey) -> dict[str, ArrayLike]:
    """Where each frame of the map was taken: the pose of the body, which is the first camera, and its tags.

    Quaternions turn the camera's frame (x right, y down, z the optical axis) to the world's.
    """
    from scipy.spatial.transform import Rotation

    found, used = survey.found, survey.found.frames
    poses = found.poses.frames[used]
    turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)
    rows = np.hstack([poses[:, :3, 3], turns])
    counts = np.bincount(found.sightings.frame[found.used], minlength=found.sightings.frames)
    times = [survey.detected.times[frame] for frame in used.tolist()]
    return {"time": times, **dict(zip(ROW, rows.T, strict=True)), "tags": counts[used]}


def sigmas(survey: Survey) -> FloatArray:
    """The standard deviation of the place of each tag beside the others, along the worst direction, metres, `(K,)`."""
    known = np.asarray(np.isfinite(survey.found.precisions).all(axis=(1, 2)))
    result = np.full(len(known), np.nan)
    largest = np.linalg.eigvalsh(survey.found.precisions[known][:, 3:, 3:])[:, -1]
    result[known] = np.sqrt(np.maximum(largest, 0.0))
    return result


def tag_columns(survey: Survey) -> dict[str, ArrayLike]:
    """Of every tag what became of it, how often and how well it was seen, and how it hangs beside its plan.

    `error` is the median of its reprojection errors, pixels, `sigma` see there; `right`, `up` and `out` are metres in
    the tag's frame, `tilt_x`, `tilt_y` and `turn` rad about its axes.
    """
    found, owner = survey.found, survey.found.sightings.tag
    error = np.sqrt(errors_at(found.sightings, found.poses) / 4.0)
    own = [error[found.used & (owner == k)] for k in range(len(survey.ids))]
    moved = np.full((len(survey.ids), 6), np.nan)
    if (planned := survey.planned) is not None:
        both = survey.placed & np.isfinite(planned[:, 0, 0])
        moved[both] = log(inverse(planned[both]) @ found.poses.tags[both])
    return {
        ID: survey.ids,
        "state": [state_of(survey, k) for k in range(len(survey.ids))],
        "seen": np.bincount(owner, minlength=len(survey.ids)),
        SIGHTINGS: survey.used,
        "misfits": np.bincount(owner[found.misfits], minlength=len(survey.ids)),
        "error": [np.median(errors) if errors.size else np.nan for errors in own],
        "sigma": np.where(survey.placed, sigmas(survey), np.nan),
        **dict(zip(("tilt_x", "tilt_y", "turn", "right", "up", "out"), moved.T, strict=True)),
    }


def state_of(survey: Survey, k: int) -> str:
    """What became of a tag, in words."""
    if survey.placed[k]:
        return "placed"
    seen = np.count_nonzero(survey.found.sightings.tag == k)
    if not seen:
        return "not seen"
    if survey.known.plan is not None and survey.ids[k] not in survey.known.ids:
        return "not believed"
    if survey.found.group[k] > 0:
        return f"in group {survey.found.group[k]}"
    return "seen once" if seen == 1 else "not placed"


def again(survey: Survey) -> IntArray:
    """The tags that need another photograph, by their index: those that are not placed, and those known worst."""
    sigma = sigmas(survey)
    known = sigma[survey.placed]
    loose = sigma > LOOSE * np.median(known) if known.size else np.zeros(len(sigma), dtype=bool)
    expected = np.isin(survey.ids, survey.known.ids) | survey.placed
    return np.flatnonzero(expected & (~survey.placed | (survey.used < FEW) | loose))


def metrics(survey: Survey) -> dict[str, float]:
    """The figures by name: metres, pixels, counts."""
    found = survey.found
    own = sigmas(survey)[survey.placed]
    figures = {
        "tags": float(survey.placed.sum()),
        "frames": float(len(found.frames)),
        SIGHTINGS: float(found.used.sum()),
        "misfits": float(found.misfits.sum()),
        "corner_floor": found.floor,
        **_quantiles("sigma", own),
        **_quantiles("error", found.errors()),
    }
    planned = survey.planned
    if planned is not None:
        away = np.linalg.norm((found.poses.tags - planned)[survey.placed][:, :3, 3], axis=1)
        figures |= _quantiles("moved", away[np.isfinite(away)])
    for name, frames in survey.localised.items():
        figures |= _quantiles(f"held_out_error_{name}", frames.errors)
        figures |= _quantiles(f"held_out_shift_{name}", frames.shifts)
    return {name: value for name, value in figures.items() if np.isfinite(value)}


def _quantiles(name: str, values: FloatArray) -> dict[str, float]:
    if not values.size:
        return {}
    return {f"{name}/{share}": float(np.quantile(values, share / 100.0)) for share in (50, 90)}


def document(survey: Survey) -> dict[str, Any]:
    """What `survey.json` holds."""
    found, times, columns = survey.found, survey.detected.times, tag_columns(survey)
    mounts = zip(survey.detected.cameras, found.poses.mounts.tolist(), strict=True)
    return {
        "figures": metrics(survey),
        "frames": len(times),
        "blurred": dict(survey.detected.blurred),
        "copies": dict(survey.detected.copies),
        "used_frames": [times[frame] for frame in found.frames.tolist()],
        "cameras": dict(mounts),
        "intrinsics": [camera.document() for camera in survey.calibrated],
        "groups": [survey.ids[found.group == g].tolist() for g in range(1, found.group.max(initial=0) + 1)],
        "another_photograph": survey.ids[again(survey)].tolist(),
        "next_photographs": [
            {
                "position": photograph.pose[:3, 3].tolist(),
                "direction": photograph.pose[:3, 2].tolist(),
                "tags": survey.ids[photograph.tags].tolist(),
                "sigma": photograph.left,
            }
            for photograph in survey.proposed
        ],
        "second_places": [
            {
                ID: int(survey.ids[place.tag]),
                "pose": place.pose.tolist(),
                SIGHTINGS: place.sightings,
                "moved_from": None if place.moved is None else times[place.moved],
                "later": place.later,
            }
            for place in survey.faults.second_places
        ],
        "sizes": {str(survey.ids[tag]): edge for tag, edge in survey.faults.sizes.items()},
        "misread": {str(survey.ids[k]): int(survey.faults.misread[k]) for k in np.flatnonzero(survey.faults.misread)},
        "tags": [dict(zip(columns, row, strict=True)) for row in zip(*map(_plain, columns.values()), strict=True)],
    }


def _plain(values: ArrayLike) -> list[Any]:
    """Values as JSON has them: null for NaN."""
    return [None if value != value else value for value in np.asarray(values).tolist()]


def to_text(survey: Survey) -> str:
    """What a terminal shows."""
    figures, found = metrics(survey), survey.found
    expected = int((survey.placed | np.isin(survey.ids, survey.known.ids)).sum())

    def both(name: str, factor: float = 1e3, digits: str = ".2g") -> str:
        low, high = (factor * figures[f"{name}/{share}"] for share in (50, 90))
        return f"{low:{digits}} (90 %: {high:{digits}})"

    lines = {
        "tags": f"{survey.placed.sum()} of {expected} placed",
        "frames": f"{len(found.frames)} of {len(survey.detected.times)}, with {found.used.sum()} sightings",
        "known to": f"{both('sigma')} mm beside each other, one standard deviation",
    }
    if "moved/50" in figures:
        lines["they hang"] = f"{both('moved', digits='.3g')} mm off their plan"
    lines["corners"] = f"{both('error', 1.0)} pixels off"
    if found.floor > NOTICED:
        lines["corners"] += f", of which a standard deviation of {found.floor:.2g} is not the detector's"
    for number, camera in enumerate(survey.calibrated, 1):
        label = f" {number}" * (len(survey.calibrated) > 1)
        lines[f"camera{label}"] = camera.to_text()
        if not camera.is_fixed:
            lines[f"not fixed{label}"] = "the camera: photograph tags on several walls at once, also held upright"
    if "measured" in survey.localised:
        lines["held out"] = (
            f"{len(survey.localised['measured'].shifts)} frames: corners {both('held_out_error_measured', 1.0)}"
        )
        lines["held out"] += " pixels off by a map made from the others"
    if "planned" in survey.localised:
        lines["planned"] = f"by the planned map {both('held_out_error_planned', 1.0)} pixels off, and the camera"
        lines["planned"] += f" {both('held_out_shift_planned', digits='.3g')} mm elsewhere"
    lines |= {label: text for label, text in _troubles(survey).items() if text}
    for number, photograph in enumerate(survey.proposed, 1):
        at, towards = (", ".join(f"{x:.2f}" for x in photograph.pose[:3, column]) for column in (3, 2))
        shown = _few(survey.ids[photograph.tags])
        lines[f"next {number}"] = f"from ({at}) towards ({towards}): {shown}"
    width = max(map(len, lines))
    return "\n".join(f"{label:<{width}} {text}" for label, text in lines.items())


def _troubles(survey: Survey) -> dict[str, str]:
    """What somebody should look at, in words; empty where there is nothing."""
    ids, times, faults, state = survey.ids.tolist(), survey.detected.times, survey.faults, tag_columns(survey)["state"]
    by_state: dict[str, list[int]] = {}
    for number, text in zip(ids, np.asarray(state).tolist(), strict=True):
        by_state.setdefault(text, []).append(number)
    sigma = sigmas(survey)
    unplanned = (
        [] if survey.known.plan is None else survey.ids[survey.placed & ~np.isin(survey.ids, survey.known.ids)].tolist()
    )
    moved = [place for place in faults.second_places if place.moved is not None]
    copies = survey.detected.copies
    worst = [f"{ids[k]} ({1e3 * sigma[k]:.2g} mm)" for k in again(survey) if survey.placed[k]]
    return {
        **{text: _few(numbers) for text, numbers in by_state.items() if text != "placed"},
        "turned": _turned(survey),
        "fixed": _off_fixed(survey),
        "not planned": _few(unplanned),
        "moved": _few(f"{ids[place.tag]} from {times[place.moved or 0]} on" for place in moved),
        "twice": _few(ids[place.tag] for place in faults.second_places if place.moved is None),
        "other size": _few(f"{ids[tag]} ({1e3 * edge:.4g} mm)" for tag, edge in faults.sizes.items()),
        "blurred": _few(f"{name} ({pixels:.2g} pixels)" for name, pixels in survey.detected.blurred.items()),
        "copies": f"{len(copies)} images, not counted: such as {next(iter(copies))} of {next(iter(copies.values()))}"
        if copies
        else "",
        "misread": _few(f"{ids[k]} ({faults.misread[k]} x)" for k in np.flatnonzero(faults.misread)),
        "photograph": _few(worst) + "; known worst" * bool(worst),
    }


def _turned(survey: Survey) -> str:
    """Which tags are turned beside their plan, by how much, and what was made of that."""
    turns, parts = survey.turns, []
    for quarters, words in enumerate(TURNS, 1):
        for renumbered in (True, False):
            own = np.flatnonzero((turns.seen == quarters) & ((turns.renumbered == quarters) == renumbered))
            if own.size:
                made = "; their corners are renumbered" if renumbered else "; they hang so in the map"
                parts.append(f"{words} beside their plan: {_few(survey.ids[own])}{made}")
    return ". ".join(parts)


def _off_fixed(survey: Survey) -> str:
    """How far photographs have tags from where they are fixed."""
    away = zip(survey.ids.tolist(), survey.off_fixed.tolist(), strict=True)
    texts = [
        f"{number} ({f'{1e3 * metres:.2g} mm' if metres == metres else f'{np.degrees(rad):.2g} degrees'})"
        for number, (metres, rad) in away
        if metres == metres or rad == rad
    ]
    return _few(texts) + "; elsewhere in the photographs: is the file exact, and each edge right?" * bool(texts)
