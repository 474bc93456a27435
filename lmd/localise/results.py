"""Tables, figures and text of a localisation."""

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lmd.adjust.estimate import Estimate
from lmd.adjust.gauge import worst_sigmas
from lmd.adjust.motion import seconds_of
from lmd.adjust.tables import (
    both,
    covariance_columns,
    document_of,
    figures_of,
    lines_of,
    pose_columns,
    pose_rows,
    quantiles,
)
from lmd.core.words import few, labelled
from lmd.localise.changes import Change
from lmd.localise.images import State
from lmd.localise.localise import Localisation

TUM = "# timestamp tx ty tz qx qy qz qw"
MOST_SENTENCES = 20  # largest number of changes that are printed
NAMED = 5  # largest number of refused frames that are named


def image_columns(result: Localisation) -> dict[str, ArrayLike]:
    """Columns of `poses.csv`: for each image, its state, the pose from this image alone, and the covariance."""
    return _columns(result, [state.value for state in result.states], result.found)


def smoothed_columns(result: Localisation) -> dict[str, ArrayLike]:
    """Columns of `smoothed.csv`, like `image_columns`."""
    nothing = np.zeros(len(result.found.used), dtype=bool)
    if (found := result.smoothed) is None:
        poses = replace(result.found.poses, frames=np.full_like(result.found.poses.frames, np.nan))
        found = replace(result.found, poses=poses, used=nothing)
        return _columns(result, ["motion unknown"] * len(result.states), found)
    known = zip(found.poses.known_frames, result.states, strict=True)
    return _columns(result, ["smoothed" if there else state.value for there, state in known], found)


def _columns(result: Localisation, states: list[str], found: Estimate) -> dict[str, ArrayLike]:
    owner, frames = found.sightings.frame[found.used], found.poses.frames
    tags, square = (np.bincount(owner, by, minlength=len(states)) for by in (None, found.squares[found.used]))
    return {
        "time": list(result.detected.times),
        "state": states,
        "tags": tags,
        "error": np.sqrt(square / np.where(tags, 4.0 * tags, np.nan)),
        **pose_columns(frames),
        **covariance_columns(frames, found.frame_covariances),
    }


def tum_text(result: Localisation, found: Estimate | None) -> str:
    """Poses in TUM's format, seconds; only a comment for frames without times, or without poses."""
    seconds = seconds_of(result.detected.times)
    if found is None or not np.isfinite(seconds).all():
        return f"{TUM}\n# {'the motion between images is unknown' if found is None else 'the images have no times'}\n"
    rows = zip(seconds, pose_rows(found.poses.frames), strict=True)
    lines = [" ".join([f"{time:.7f}", *(f"{x:.9f}" for x in row)]) for time, row in rows if np.isfinite(row[0])]
    return "\n".join([TUM, *lines, ""])


def change_columns(result: Localisation) -> dict[str, ArrayLike]:
    """Columns of `changes.csv`: tags that were moved, have vanished or are new, with their present poses.

    Positions are metres, quaternions rotate the frame of the tag (x right, y up, z out) to the map, and covariances are
    those of `poses.csv`. `moved_right`, `moved_up` and `moved_out` are metres along the axes of the tag's pose in the
    map.
    """
    every = result.changes
    poses = np.array([one.pose for one in every]).reshape(-1, 4, 4)
    shifts = np.array([one.shift for one in every]).reshape(-1, 3)
    return {
        "id": [one.tag for one in every],
        "change": [one.kind for one in every],
        "images": [one.images for one in every],
        "distance": np.linalg.norm(shifts, axis=1),
        "rotation": [one.radians for one in every],
        "chi_square": [one.chi_square for one in every],
        **dict(zip(("moved_right", "moved_up", "moved_out"), shifts.T, strict=True)),
        **pose_columns(poses),
        **covariance_columns(poses, np.array([one.covariance for one in every]).reshape(-1, 6, 6)),
    }


def _sentence(change: Change) -> str:
    """Sentence on a change."""
    if change.kind == "vanished":
        return f"tag {change.tag} vanished: {change.images} views should show it, and none does."
    known = f"known to {1e3 * worst_sigmas(change.covariance[None])[0, 0]:.2g} mm by {change.images} images."
    if change.kind == "new":
        return f"tag {change.tag} is new, at ({', '.join(f'{x:.3f}' for x in change.pose[:3, 3])}), {known}"
    way, turn = 1e3 * np.linalg.norm(change.shift), np.degrees(change.radians)
    return f"tag {change.tag} was moved by {way:.3g} mm and {turn:.2g} degrees, {known}"


def metrics(result: Localisation) -> dict[str, float]:
    """Figures by name: metres, rad, pixels, counts."""
    figures = {
        "frames": float(len(result.states)),
        "compared": float(len(result.compared)),
        **figures_of(result.found),
        **{kind: float(count) for kind, count in Counter(change.kind for change in result.changes).items()},
    }
    for prefix, found in (("", result.found), ("smoothed_", result.smoothed)):
        if found is not None:
            figures["smoothed" if prefix else "localised"] = float(found.poses.known_frames.sum())
            place, turn = worst_sigmas(found.frame_covariances).T
            figures |= quantiles(f"{prefix}sigma", place) | quantiles(f"{prefix}sigma_turn", turn)
    return figures


def localise_document(result: Localisation) -> dict[str, Any]:
    """Content of `localise.json`."""
    states = zip(result.detected.times, result.states, strict=True)
    return {
        "figures": metrics(result),
        "refused": {name: state.value for name, state in states if state is not State.LOCALISED},
        "renumbered_quarters": result.renumbered,
        "changes": [_sentence(change) for change in result.changes],
        "compared": result.compared.tolist(),
        "contradicted": result.contradicted,
        "doubts": list(result.doubts),
        **document_of(result.calibrated, result.detected, result.sizes),
    }


def to_text(result: Localisation) -> str:
    """Lines for a terminal."""
    figures, names = metrics(result), np.array(result.detected.times)
    known, count = result.found.poses.known_frames, len(result.states)
    lines = {"frames": f"{known.sum()} of {count} localised, by {result.found.used.sum()} sightings"}
    for label, prefix, about in (("known to", "", "each by one image"), ("smoothed", "smoothed_", "together")):
        if f"{prefix}sigma/50" in figures:
            place, turn = (both(figures, f"{prefix}{name}") for name in ("sigma", "sigma_turn"))
            lines[label] = f"{place} mm and {turn} mrad, one standard deviation, {about}"
    if result.renumbered:
        lines["turned"] = "corners of all detections are numbered from another corner, and are renumbered"
    refused = {state: names[[one is state for one in result.states]] for state in State if state is not State.LOCALISED}
    if any(map(len, refused.values())):
        texts = (f"{len(own)} ({few(own, most=NAMED)}): {state.value}" for state, own in refused.items() if len(own))
        lines["refused"] = "; ".join(texts)
    compared = f"{len(result.compared)} of {len(result.known.ids)} tags could be compared with the map"
    lines["changes"] = f"{len(result.changes) or 'none'}; {compared}"
    if not result.in_room:
        lines["vanished"] = "not looked for, as a room that is not known may hide tags; give run=DIR, room=..., or a "
        lines["vanished"] += "run with a room as map=DIR"
    if result.contradicted:
        lines["map"] = f"{result.contradicted} tags differ from it, too many to have been moved; check the "
        lines["map"] += "calibration, the edge of the tags, and the standard deviations of the map"
    lines |= lines_of(result.found, result.calibrated, result.detected, result.sizes, result.doubts)
    return "\n".join([labelled(lines), *map(_sentence, result.changes[:MOST_SENTENCES])])
