"""Fit of a detector's limits to views of single tags, and scores of the fitted limits.

Limits are the smallest pitch (pixels per module), the largest incidence angle and other values at which a detector
still finds a tag.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lmd.core.checks import BoolArray, FloatArray, InputError
from lmd.core.words import escaped, markdown_table
from lmd.detection.detectors import TAG_NUMBERS, Matches, agreement, precision_recall, shares_of_frames
from lmd.detection.frames import overlapping, qualities
from lmd.detection.tag_views import Placed, TagViews
from lmd.render.renderer import Renderer
from lmd.sight.models.limits import NAMES, Limits, Preset

# Candidate values of the limits; units as in `Limits`.
PITCHES, BLURS = np.linspace(0.0, 3.0, 31), np.linspace(0.0, 4.0, 41)
EDGES, INCIDENCES = np.linspace(0.0, 40.0, 41), np.linspace(40.0, 89.0, 50)
MARGINS = np.linspace(0.0, 150.0, 31)
# Candidate diameters of an image circle, relative to the smallest circle that contains all views.
CIRCLES = np.linspace(1.0, 0.4, 61)
# Evidence for an image circle: minimum number of views beyond it, and maximum share of these views that is detected.
FEWEST_BEYOND, FOUND_BEYOND = 20, 0.05

Errors = Callable[[BoolArray, BoolArray], NDArray[np.intp]]
Choice = tuple[int, ...]


@dataclass(frozen=True)
class Fit:
    """Limits within which a detector finds tags, fitted to half of the views, with their scores on the other half."""

    limits: Limits
    """Limits of the detector."""
    accuracy: float
    """Fraction of the views for which the limits predict detection or no detection correctly."""
    precision: float
    """Precision: of the tags that were predicted as detected, the fraction that the detector found."""
    recall: float
    """Recall: of the tags that the detector found, the fraction that was predicted as detected."""
    circles: tuple[float, ...] = ()
    """Diameter of each camera's image circle, beyond which the detector finds nothing, pixels; infinite if no circle
    was found. The tuple is empty if the views are not from a recording (`TagViews.placed` is None).
    """

    @property
    def known_circles(self) -> dict[int, float]:
        """Diameters of the image circles that were found, pixels, keyed by the number of the camera, from 1.

        Outside the image circle of a camera the detector finds no tag.
        """
        return {number: diameter for number, diameter in enumerate(self.circles, 1) if math.isfinite(diameter)}

    def circles_text(self, detector: str) -> str:
        """Message with a line for each image circle that was found: its diameter, and the number of the camera.

        `detector` is the name of the detector.
        """
        return "".join(
            f"{detector} finds nothing beyond an image circle of {diameter:.0f} pixels, of camera {number}\n"
            for number, diameter in self.known_circles.items()
        )


@dataclass(frozen=True)
class DetectorCalibration:
    """Fitted limits of one detector, the views of tags to which they are fitted, and scores of their predictions."""

    views: TagViews
    """Views of single tags, to which the limits are fitted."""
    fit: Fit
    """Fitted limits and their scores."""
    rooms: dict[str, float]
    """Scores of the predictions in frames of rendered rooms, keyed as in `frame_scores`; may be empty."""
    photographs: int = 0
    """Number of photographs that the views were taken from; 0 for rendered views."""

    def figures(self) -> dict[str, float]:
        """Row of a table, keyed by column: numbers of views and photographs, fitted limits, and scores."""
        limits, fit = self.fit.limits, self.fit
        return {
            "views": len(self.views),
            "seen": float(self.views.seen.mean()),
            **{name: getattr(limits, name) for name in NAMES},
            **{name: getattr(fit, name) for name in ("accuracy", "precision", "recall")},
            **{f"image_circle_{number}": diameter for number, diameter in fit.known_circles.items()},
            "photographs": self.photographs,
            **{f"room_{name}": value for name, value in self.rooms.items()},
        }

    def preset(self, detector: str, family: str, source: str) -> str:
        """Text of a preset file (YAML) that contains the limits, with the scores as comments.

        Args:
            detector: name of the detector.
            family: tag family.
            source: description of the views.
        """
        fit = self.fit
        lines = [f"Limits of {detector} for tags of the family {family}: {source}."]
        origin = f"{self.photographs} photographs" if self.photographs else "renderings, not on photographs"
        lines.append(f"Measured on {origin}.")
        half = "half" if self.views.placed is None else "the first half, in time,"
        lines.append(
            f"Fitted to {half} of {len(self.views)} views; on the other half accuracy {fit.accuracy:.3f}, "
            f"precision {fit.precision:.3f}, recall {fit.recall:.3f}."
        )
        if fit.known_circles:
            ends = (f"{diameter:.0f} pixels of camera {number}" for number, diameter in fit.known_circles.items())
            lines.append(f"Fitted with them: image_circle {', '.join(ends)}.")
        if self.rooms:
            pairs = (f"{self.rooms[f'predicted_{n}']:.3f} / {self.rooms[f'detected_{n}']:.3f}" for n in TAG_NUMBERS)
            lines.append(
                f"In {self.rooms['frames']:.0f} frames of a room: P(>= 1..4) predicted / detected {', '.join(pairs)}; "
                f"precision {self.rooms['precision']:.3f}, recall {self.rooms['recall']:.3f}; "
                f"{self.rooms['agreement_2']:.1%} of the frames agree on >= 2."
            )
        return Preset(detector, family, fit.limits).to_yaml(lines)


def predicted_in_frames(limits: Limits, renderer: Renderer, poses: FloatArray) -> BoolArray:
    """Mask of the tags that should be detected according to the limits, `(N, K)`, for K tags in N frames.

    Tags that overlap another tag on the wall are False.

    Args:
        limits: limits of the detector.
        renderer: camera and tags.
        poses: poses of the camera, camera to world, `(N, 4, 4)`.
    """
    found = limits.found(*qualities(renderer, poses)) & renderer.inside(poses, limits.margin)
    return np.asarray(found & ~overlapping(renderer.room))


def frame_scores(predicted: BoolArray, seen: Matches) -> dict[str, float]:
    """Scores of predictions for N frames: number of `frames`, `precision` and `recall`. `predicted_<n>` and
    `detected_<n>` are the fractions P(>= n) of frames with at least n predicted or detected tags. `agreement_2` is the
    fraction of frames in which prediction and detection agree on whether at least two tags are found.

    Args:
        predicted: mask of the tags that are predicted as detected, `(N, K)`.
        seen: detections in the N frames, matched with the tags.
    """
    precision, recall = precision_recall(predicted, seen.detected)
    row = {"frames": float(len(predicted)), "precision": float(precision), "recall": float(recall)}
    for name, which in (("predicted", predicted), ("detected", seen.detected)):
        shares = shares_of_frames(which).share
        row |= {f"{name}_{n}": float(share) for n, share in zip(TAG_NUMBERS, shares, strict=True)}
    return row | {"agreement_2": agreement(predicted, seen.detected)}


def fit(views: TagViews, rng: np.random.Generator, margin: float) -> Fit:
    """Fit the limits of a detector to one half of the views, and score them on the other half.

    Views that are not from a recording (`placed` is None) are halved at random. The fit minimises max(false positives,
    false negatives). So the two kinds of error are balanced, and the predicted fraction of frames with at least n tags
    is unbiased.

    The views of a recording are halved in time, as consecutive images are similar. The fit minimises the total number
    of wrong predictions. Balanced errors would compensate for tags that are missed because of glare or occlusion, which
    the limits do not model. The margin, and the image circle of each camera, are fitted, too.

    Args:
        views: at least two views; views of a recording must be from images taken at two or more different times.
        rng: random generator that halves the views.
        margin: least distance between the image border and the corners of a tag that the detector finds, pixels. Views
            that are not from a recording do not determine the margin, so the limits contain `margin` unchanged. For a
            recording, `margin` is the lower bound of the fitted margin.

    Raises:
        InputError: there are too few views, or the margin is negative.
    """
    if len(views) < 2:
        raise InputError(f"views must be at least 2, got {len(views)}.")
    if views.placed is None:
        order = rng.permutation(len(views))
        train, held_out = views[order[::2]], views[order[1::2]]
    else:
        moments = np.unique(views.placed.moment)
        if len(moments) < 2:
            raise InputError("views must be of images taken at two or more different times, but all are of one time.")
        early = views.placed.moment < moments[len(moments) // 2]
        train, held_out = views[early], views[~early]
    limits, circles = _best(train, margin)
    predicted = predicted_views(held_out, limits, circles)
    precision, recall = precision_recall(predicted, held_out.seen)
    return Fit(limits, float((predicted == held_out.seen).mean()), float(precision), float(recall), circles)


def predicted_views(views: TagViews, limits: Limits, circles: tuple[float, ...]) -> BoolArray:
    """Mask of the views whose tag should be detected according to the detector's limits and the cameras' image circles,
    `(M,)`. `circles` are the diameters of the image circles, pixels, one for each camera; they are used only for views
    from a recording.
    """
    found = limits.found(views.pitch, views.incidence, views.edge, views.sigma)
    if (placed := views.placed) is None:
        return found
    return found & (placed.border >= limits.margin) & ~(placed.circle > np.array(circles)[placed.camera])


def _best(views: TagViews, margin: float) -> tuple[Limits, tuple[float, ...]]:
    """Find the limits, and the diameter of each camera's image circle, that predict the detections in `views` best.

    The fit minimises the number of wrong predictions for a recording, otherwise max(false positives, false negatives).
    `margin`, pixels, becomes part of the limits; for a recording, it is the lower bound of the fitted margin. The
    diameters, pixels, are empty without a recording.
    """
    placed, margins, circles = views.placed, np.array([margin]), []
    sharp = views.pitch >= np.hypot(PITCHES[:, None, None], BLURS[:, None] * views.sigma)  # (A, K, M)
    facing = views.incidence <= np.radians(INCIDENCES)[:, None]  # (B, M)
    groups = [sharp, (views.edge >= EDGES[:, None, None]) & facing]  # (E, B, M)
    start: list[Choice] = [(0, 0), (0, len(facing) - 1)]
    if placed is None:
        # Of two searches, the better result is taken; the first search starts from the limits with the fewest errors in
        # total.
        searches = ((_all_errors, _larger_errors), (_larger_errors,))
        _, chosen = min(_searched(groups, start, views.seen, kinds) for kinds in searches)
    else:
        margins, circles = np.append(margins, MARGINS[margin < MARGINS]), _circles(views, placed)
        groups.append(placed.border >= margins[:, None])
        groups += [(placed.camera != c) | ~(placed.circle > own[:, None]) for c, own in enumerate(circles)]
        _, chosen = _searched(groups, [*start, *[(0,)] * (1 + len(circles))], views.seen, (_all_errors,))
    (a, k), (e, b), *rest = chosen
    m, *ends = [index for (index,) in rest] or [0]
    limits = Limits(*map(float, (PITCHES[a], BLURS[k], EDGES[e], INCIDENCES[b], margins[m])))
    return limits, tuple(float(own[end]) for own, end in zip(circles, ends, strict=True))


def _circles(views: TagViews, placed: Placed) -> list[FloatArray]:
    """For each camera, candidate diameters of its image circle, pixels, in descending order.

    The first candidate is infinite: the detector finds tags in the whole image.
    """
    each = []
    for camera in range(placed.camera.max() + 1):
        own = (placed.camera == camera) & np.isfinite(placed.circle)
        needed, found = placed.circle[own], views.seen[own]
        sizes = CIRCLES * needed.max(initial=0.0)
        beyond = needed > sizes[:, None]
        count = beyond.sum(axis=1)
        ends = (count >= FEWEST_BEYOND) & ((beyond & found).sum(axis=1) <= FOUND_BEYOND * count)
        each.append(np.append(np.inf, sizes[ends]))
    return each


def _searched(
    groups: list[BoolArray], start: list[Choice], seen: BoolArray, kinds: tuple[Errors, ...]
) -> tuple[int, list[Choice]]:
    """Find the values of limits that minimise several error counts, one count after the other.

    The search for each count starts at the optimum of the previous one. Some limits are optimised jointly, as a group.
    Group by group, the search tries all combinations of candidate values of the group's limits, until no group lowers
    the error count.

    Args:
        groups: for each group, masks of the M views that meet its limits, `(..., M)`; the leading axes run over the
            candidate values.
        start: for each group, the indices of the candidate values at which the first search starts.
        seen: mask of the views whose tag is detected, `(M,)`.
        kinds: functions that count the errors, given a mask of the predicted views and `seen`.

    Returns:
        minimum of the last error count; and for each group, the indices of the best candidate values.
    """
    chosen, least = list(start), 0
    for errors in kinds:
        least, moved = len(seen) + 1, True
        while moved:
            moved = False
            for g, table in enumerate(groups):
                others = [other[at] for o, (other, at) in enumerate(zip(groups, chosen, strict=True)) if o != g]
                wrong = errors(table & np.logical_and.reduce(others), seen)
                if wrong.min() < least:
                    least, moved = int(wrong.min()), True
                    chosen[g] = tuple(int(i) for i in np.unravel_index(wrong.argmin(), wrong.shape))
    return least, chosen


def _all_errors(predicted: BoolArray, seen: BoolArray) -> NDArray[np.intp]:
    """Number of views along the last axis whose detection is predicted wrongly."""
    return np.asarray((predicted != seen).sum(axis=-1))


def _larger_errors(predicted: BoolArray, seen: BoolArray) -> NDArray[np.intp]:
    """Number of false positives or of false negatives among the views along the last axis, the larger of the two."""
    return np.asarray(np.maximum((predicted & ~seen).sum(axis=-1), (~predicted & seen).sum(axis=-1)))


def limits_markdown(figures: dict[str, dict[str, float]]) -> str:
    """Markdown table with the limits of each detector, and the accuracy with which these limits predict the held-out
    views. `figures` has the results of `DetectorCalibration.figures`, keyed by detector.
    """
    head = ["detector", "views", "a", "k", "m [px]", "b [degrees]", "margin [px]"]
    head += ["held-out accuracy / precision / recall"]
    head += [f"rooms: P(>= {n}) predicted / detected" for n in range(1, 5)]
    head += ["rooms: precision / recall", "rooms: frames agree on >= 2"]
    rows = []
    for name, row in figures.items():
        cells = [escaped(name), f"{row['views']:.0f}", *(f"{row[key]:.2g}" for key in ("pitch", "blur"))]
        cells += [f"{row['edge']:.3g}", f"{row['incidence']:.0f}", f"{row['margin']:.3g}"]
        cells += [f"{row['accuracy']:.3f} / {row['precision']:.3f} / {row['recall']:.3f}"]
        if "room_frames" in row:
            cells += [f"{row[f'room_predicted_{n}']:.3f} / {row[f'room_detected_{n}']:.3f}" for n in range(1, 5)]
            cells += [f"{row['room_precision']:.3f} / {row['room_recall']:.3f}", f"{row['room_agreement_2']:.1%}"]
        else:
            cells += ["–"] * 6
        rows.append(cells)
    return markdown_table(head, rows) + "\n"
