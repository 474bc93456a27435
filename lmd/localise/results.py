"""Tables, metrics and text of a localisation."""

from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lmd.adjust.estimate import Estimate
from lmd.adjust.gauge import worst_sigmas
from lmd.adjust.tables import (
    both,
    clock_figures,
    covariance_columns,
    document_of,
    figures_of,
    lines_of,
    pose_columns,
    quantiles,
)
from lmd.core.words import few, labelled
from lmd.localise.changes import Change
from lmd.localise.images import State
from lmd.localise.localise import Localisation

NAMED = 5  # largest number of refused frames, and of tags without a detection, that are named


def frame_columns(result: Localisation, found: Estimate) -> dict[str, ArrayLike]:
    """Columns of `poses.csv` or `smoothed.csv`: state of each image, number of inliers, error, pose, and covariance.
    The state is that the image is localised, or the reason why not. `found` is the estimate from single images or the
    smoothed estimate.
    """
    name = State.LOCALISED.value if found is result.found else "smoothed"
    known = zip(found.poses.known_frames, result.states, strict=True)
    owner, frames = found.sightings.frame[found.used], found.poses.frames
    tags, square = (np.bincount(owner, by, minlength=len(frames)) for by in (None, found.squares[found.used]))
    return {
        "time": list(result.detected.times),
        "state": [name if there else state.value for there, state in known],
        "tags": tags,
        "error": np.sqrt(square / np.where(tags, 4.0 * tags, np.nan)),
        **pose_columns(frames),
        **covariance_columns(frames, found.frame_covariances),
    }


def change_columns(result: Localisation) -> dict[str, ArrayLike]:
    """Columns of `changes.csv`: tags that were moved or are new, with their present poses.

    Positions are metres, and quaternions rotate the frame of the tag (x right, y up, z out) to the map. Covariances are
    those of position and rotation in the map's frame. `moved_right`, `moved_up` and `moved_out` are metres along the
    axes of the tag's pose in the map.
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
    """Sentence for the user on a moved or new tag."""
    known = f"known to {1e3 * worst_sigmas(change.covariance[None])[0, 0]:.2g} mm by {change.images} images."
    if change.kind == "new":
        return f"tag {change.tag} is new, at ({', '.join(f'{x:.3f}' for x in change.pose[:3, 3])}), {known}"
    way, turn = 1e3 * np.linalg.norm(change.shift), np.degrees(change.radians)
    return f"tag {change.tag} was moved by {way:.3g} mm and {turn:.2g} degrees, {known}"


def metrics(result: Localisation) -> dict[str, float]:
    """Metrics of the localisation, keyed by name: lengths in metres, angles in rad, errors in pixels, counts."""
    figures = {
        "frames": float(len(result.states)),
        "compared": float(np.isfinite(result.comparison.squares).sum()),
        **figures_of(result.found),
        **{kind: float(count) for kind, count in Counter(change.kind for change in result.changes).items()},
    }
    for prefix, found in (("", result.found), ("smoothed_", result.smoothed)):
        if found is not None:
            figures["smoothed" if prefix else "localised"] = float(found.poses.known_frames.sum())
            place, turn = worst_sigmas(found.frame_covariances).T
            figures |= quantiles(f"{prefix}sigma", place) | quantiles(f"{prefix}sigma_turn", turn)
            figures |= clock_figures(found)
    return figures


def localise_document(result: Localisation) -> dict[str, Any]:
    """Content of the file `localise.json`: metrics, refused images, changes of the map, and doubts (sentences for the
    user).
    """
    states = zip(result.detected.times, result.states, strict=True)
    return {
        "figures": metrics(result),
        "refused": {name: state.value for name, state in states if state is not State.LOCALISED},
        "renumbered_quarters": result.renumbered,
        "changes": [_sentence(change) for change in result.changes],
        "contradicted": result.comparison.contradicted,
        "doubts": list(result.doubts),
        **document_of(result.smoothed or result.found, result.detected, result.sizes),
    }


def to_text(result: Localisation) -> str:
    """Text for a terminal: lines on the result, then a sentence for each change of the map."""
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
    compared = f"{figures['compared']:.0f} of {len(result.known.ids)} tags could be compared with the map"
    lines["changes"] = f"{len(result.changes) or 'none'}; {compared}"
    if (gone := ~np.isin(result.known.ids, result.detected.ids)).any():
        lines["not seen"] = few(result.known.ids[gone], most=NAMED)
    if result.comparison.contradicted:
        lines["map"] = f"{result.comparison.contradicted} tags differ from it, too many to have been moved; check the "
        lines["map"] += "calibration, the edge of the tags, and the standard deviations of the map"
    lines |= lines_of(result.smoothed or result.found, result.detected, result.sizes, result.doubts)
    return "\n".join([labelled(lines), *map(_sentence, result.changes)])
