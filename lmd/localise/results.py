"""Tables, figures and text of a localisation."""

from collections import Counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lmd.adjust.gauge import covariance_columns, in_world, quantiles
from lmd.adjust.motion import seconds_of
from lmd.core.checks import FloatArray
from lmd.core.words import few, labelled
from lmd.geometry.se3 import ROW
from lmd.localise.changes import Displaced
from lmd.localise.images import State
from lmd.localise.localise import FramePoses, Localisation

TUM = "# timestamp tx ty tz qx qy qz qw"
NOTICED = 0.01  # minimum floor of the corners' standard deviation that is printed, pixels
MOST_SENTENCES = 20  # largest number of changes that are printed
NAMED = 5  # largest number of refused frames that are named


class Change(NamedTuple):
    """Change of a map."""

    tag: int
    """Id of the tag."""
    kind: str
    """`moved`, `vanished` or `new`."""
    images: int
    """Number of images that show it; of a tag that vanished, number of views that should."""
    found: Displaced | None
    """Present pose; None if the tag vanished."""


def image_columns(result: Localisation) -> dict[str, ArrayLike]:
    """Columns of `poses.csv`: a row for each image, with its state, its pose from this image alone, and covariances."""
    return _columns(result, [state.value for state in result.found.states], result.found)


def smoothed_columns(result: Localisation) -> dict[str, ArrayLike]:
    """Columns of `smoothed.csv`, as `image_columns`."""
    if result.smoothed is None:
        return _columns(result, ["motion unknown"] * len(result.detected.times), None)
    known = result.smoothed.localised
    states = ["smoothed" if there else state.value for there, state in zip(known, result.found.states, strict=True)]
    return _columns(result, states, result.smoothed)


def _columns(result: Localisation, states: list[str], found: FramePoses | None) -> dict[str, ArrayLike]:
    count = len(states)
    frames, covariances = np.full((count, 4, 4), np.nan), np.full((count, 6, 6), np.nan)
    tags: FloatArray = np.zeros(count)
    square: FloatArray = np.zeros(count)
    if found is not None:
        frames, covariances, estimate = found.frames, found.covariances, found.estimate
        owner = estimate.sightings.frame[found.used]
        np.add.at(tags, owner, 1.0)
        np.add.at(square, owner, estimate.squares[found.used])
    return {
        "time": list(result.detected.times),
        "state": states,
        "tags": tags.astype(int),
        "error": np.sqrt(square / np.where(tags, 4.0 * tags, np.nan)),
        **dict(zip(ROW, _rows(frames).T, strict=True)),
        **covariance_columns(in_world(frames, covariances)),
    }


def _rows(frames: FloatArray) -> FloatArray:
    """Position and quaternion of each pose, `(F, 7)`; NaN without a pose."""
    from scipy.spatial.transform import Rotation

    rows, known = np.full((len(frames), 7), np.nan), np.isfinite(frames[:, 0, 0])
    rows[known, :3] = frames[known, :3, 3]
    if known.any():
        rows[known, 3:] = Rotation.from_matrix(frames[known, :3, :3]).as_quat(canonical=True)
    return rows


def tum_text(result: Localisation, frames: FloatArray | None) -> str:
    """Poses in TUM's format, seconds; a comment alone for frames without times, or without poses."""
    seconds = seconds_of(result.detected.times)
    if frames is None or not np.isfinite(seconds).all():
        return f"{TUM}\n# {'the motion between images is unknown' if frames is None else 'the images have no times'}\n"
    rows = _rows(frames)
    known = np.flatnonzero(np.isfinite(rows[:, 0])).tolist()
    lines = [" ".join([f"{seconds[k]:.7f}", *(f"{value:.9f}" for value in rows[k])]) for k in known]
    return "\n".join([TUM, *lines, ""])


def _sigmas(frames: FloatArray, covariances: FloatArray) -> FloatArray:
    """Standard deviations in the worst direction of the position, metres, and rotation, rad, of each pose, `(n, 2)`."""
    known = np.isfinite(frames[:, 0, 0])
    parts = (slice(3, 6), slice(0, 3))
    largest = [np.linalg.eigvalsh(covariances[known][:, part, part])[:, -1] for part in parts]
    return np.asarray(np.sqrt(np.maximum(np.stack(largest, axis=1), 0.0)))


def changes_of(result: Localisation) -> list[Change]:
    """Changes of the map, by kind, then by id."""
    changes = result.changes
    moved = [Change(one.tag, "moved", one.sightings, one) for one in sorted(changes.moved, key=lambda one: one.tag)]
    gone = [Change(tag, "vanished", views, None) for tag, views in sorted((result.vanished or {}).items())]
    new = [Change(one.tag, "new", one.sightings, one) for one in sorted(changes.new, key=lambda one: one.tag)]
    return [*moved, *gone, *new]


def change_columns(result: Localisation) -> dict[str, ArrayLike]:
    """Columns of `changes.csv`: tags that were moved, that vanished, and that are new, with their present poses.

    Positions are metres, quaternions rotate the frame of the tag (x right, y up, z out) to the map, and covariances are
    those of `poses.csv`. `moved_right`, `moved_up` and `moved_out` are metres along the axes that the tag had.
    """
    every = changes_of(result)
    poses, covariances, shifts = np.full((len(every), 4, 4), np.nan), np.full((len(every), 6, 6), np.nan), []
    for n, change in enumerate(every):
        shift = np.full(3, np.nan)
        if (found := change.found) is not None:
            poses[n], covariances[n] = found.pose, found.covariance
            if change.kind == "moved":
                before = result.known.poses[np.searchsorted(result.known.ids, change.tag)]
                shift = before[:3, :3].T @ (found.pose[:3, 3] - before[:3, 3])
        shifts.append(shift)
    nothing = [np.nan] * 3
    figures = np.array(
        [nothing if one.found is None else [one.found.metres, one.found.radians, one.found.chi_square] for one in every]
    ).reshape(-1, 3)
    return {
        "id": [change.tag for change in every],
        "change": [change.kind for change in every],
        "images": [change.images for change in every],
        **dict(zip(("distance", "rotation", "chi_square"), figures.T, strict=True)),
        **dict(zip(("moved_right", "moved_up", "moved_out"), np.array(shifts).reshape(-1, 3).T, strict=True)),
        **dict(zip(ROW, _rows(poses).T, strict=True)),
        **covariance_columns(in_world(poses, covariances)),
    }


def _sentence(change: Change) -> str:
    """Sentence on a change."""
    found = change.found
    if found is None:
        return f"tag {change.tag} vanished: {change.images} views should show it, and none does."
    sigma = 1e3 * float(np.sqrt(np.linalg.eigvalsh(found.covariance[3:, 3:])[-1]))
    x, y, z = found.pose[:3, 3]
    if change.kind == "new":
        at = f"({x:.3f}, {y:.3f}, {z:.3f})"
        return f"tag {change.tag} is new, at {at}, known to {sigma:.2g} mm by {change.images} images."
    turn = np.degrees(found.radians)
    return (
        f"tag {change.tag} was moved by {1e3 * found.metres:.3g} mm and {turn:.2g} degrees, known to {sigma:.2g} mm by "
        f"{change.images} images."
    )


def metrics(result: Localisation) -> dict[str, float]:
    """Figures by name: metres, rad, pixels, counts."""
    found = result.found
    figures = {
        "frames": float(len(found.states)),
        "localised": float(found.localised.sum()),
        "sightings": float(found.used.sum()),
        "corner_floor": found.estimate.floor,
        "compared": float(len(result.changes.compared)),
        **{kind: float(count) for kind, count in Counter(change.kind for change in changes_of(result)).items()},
        **_quantiles("", _sigmas(found.frames, found.covariances)),
    }
    if result.smoothed is not None:
        smoothed = result.smoothed
        figures["smoothed"] = float(np.isfinite(smoothed.frames[:, 0, 0]).sum())
        figures |= _quantiles("smoothed_", _sigmas(smoothed.frames, smoothed.covariances))
    return figures


def _quantiles(prefix: str, sigmas: FloatArray) -> dict[str, float]:
    return quantiles(f"{prefix}sigma", sigmas[:, 0]) | quantiles(f"{prefix}sigma_turn", sigmas[:, 1])


def localise_document(result: Localisation) -> dict[str, Any]:
    """Content of `localise.json`."""
    names = result.detected.times
    return {
        "figures": metrics(result),
        "refused": {
            name: state.value
            for name, state in zip(names, result.found.states, strict=True)
            if state is not State.LOCALISED
        },
        "blurred": dict(result.detected.blurred),
        "copies": dict(result.detected.copies),
        "renumbered_quarters": result.renumbered,
        "changes": [_sentence(change) for change in changes_of(result)],
        "compared": result.changes.compared.tolist(),
        "sizes": {str(tag): edge for tag, edge in result.changes.sizes.items()},
        "intrinsics": [camera.document() for camera in result.calibrated],
        "inflation": result.changes.inflation,
        "contradicted": result.changes.contradicted,
        "doubts": list(result.doubts),
    }


def to_text(result: Localisation) -> str:
    """Lines for a terminal."""
    figures, found = metrics(result), result.found

    def known_to(prefix: str) -> str:
        (place, places), (turn, turns) = (
            [1e3 * figures[f"{prefix}{name}/{share}"] for share in (50, 90)] for name in ("sigma", "sigma_turn")
        )
        return f"{place:.2g} (90 %: {places:.2g}) mm and {turn:.2g} (90 %: {turns:.2g}) mrad, one standard deviation"

    lines = {"frames": f"{found.localised.sum()} of {len(found.states)} localised, by {found.used.sum()} sightings"}
    if found.localised.any():
        lines["known to"] = f"{known_to('')}, each by one image"
    if result.smoothed is not None:
        lines["smoothed"] = f"{figures['smoothed']:.0f} frames, known to {known_to('smoothed_')}"
    if found.estimate.floor > NOTICED:
        lines["corners"] = f"a standard deviation of {found.estimate.floor:.2g} pixels is not the detector's"
    for number, camera in enumerate(result.calibrated, 1):
        lines["camera" if len(result.calibrated) == 1 else f"camera {number}"] = camera.to_text()
    if result.renumbered:
        lines["turned"] = "corners of all detections are numbered from another corner, and are renumbered"
    names = result.detected.times
    for state, count in Counter(found.states).items():
        if state is not State.LOCALISED:
            own = [name for name, other in zip(names, found.states, strict=True) if other is state]
            lines.setdefault("refused", "")
            lines["refused"] += f"{'; ' if lines['refused'] else ''}{count} ({few(own, most=NAMED)}): {state.value}"
    if result.detected.blurred:
        lines["blurred"] = few(result.detected.blurred, most=NAMED)
    every = changes_of(result)
    compared = f"{len(result.changes.compared)} of {len(result.known.ids)} tags could be compared with the map"
    lines["changes"] = f"{len(every) or 'none'}; {compared}"
    if result.vanished is None:
        lines["vanished"] = (
            "not looked for: no room is known that may hide tags; run=DIR or room=... gives one, or a run "
        )
        lines["vanished"] += "with a room as map=DIR"
    if result.changes.sizes:
        sizes = (f"{tag} ({1e3 * edge:.4g} mm)" for tag, edge in result.changes.sizes.items())
        lines["other size"] = few(sizes, most=MOST_SENTENCES)
    if result.changes.contradicted:
        lines["map"] = f"{result.changes.contradicted} tags differ from it, too many to have been moved: is it another "
        lines["map"] += "calibration or another edge of the tags, or does the map state too small errors?"
    if result.changes.inflation > 1.0:
        lines["blocks"] = f"of time disagree {result.changes.inflation:.1f} times as much as corners explain"
    if result.doubts:
        lines["check"] = " ".join(result.doubts)
    return "\n".join([labelled(lines), *map(_sentence, every[:MOST_SENTENCES])])
