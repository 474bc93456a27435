"""What a visibility model predicts for the frames of a survey, beside what was really detected in them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd

from lmd.core.checks import BoolArray, FloatArray
from lmd.detection.comparison import PITCHES, CameraPrediction, Prediction, by_incidence, by_pitch, by_place, by_tag
from lmd.detection.evaluation import CORNER_TOLERANCE, Matches, precision_recall
from lmd.detection.frames import tagged_room
from lmd.geometry.camera import Camera
from lmd.geometry.se3 import pose_of
from lmd.render.renderer import Renderer
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.views import visible_through
from lmd.space.cuboid import Cuboid
from lmd.survey.report import map_of
from lmd.survey.residuals import errors_at
from lmd.survey.survey import Survey

# A tag stands out that is detected so many standard deviations less often than others of its pitch, and half as often.
STANDS_OUT, HALF = 4.0, 0.5
# Misses of a tag in so many images, one after the other of those that are predicted to show it, have one cause.
IN_A_ROW = 5
# Of a room that is not known: how far from everything its walls are, metres, and how long the mean of the tags' unit
# vectors up must be to tell where up is.
AROUND, LEAST_UP = 1.0, 0.3

Verdicts = Callable[[Scene, Deployment, FloatArray, Camera], dict[str, BoolArray]]


@dataclass(frozen=True)
class Audit:
    """N frames of a survey, and the K tags of its map; of C cameras C K tags, camera by camera.

    Args:
        prediction: what was predicted of them.
        seen: what was detected; false are detections that do not show a tag where it hangs.
    """

    prediction: Prediction
    seen: Matches

    @cached_property
    def expected(self) -> FloatArray:
        """The chance of each tag to be detected if it is like others of its pitch, `(N, C K)`; 0 if not predicted."""
        visible, detected = self.prediction.visible, self.seen.detected
        place = np.searchsorted(PITCHES, self.prediction.pitch, side="right") - 1
        chance = np.zeros(visible.shape)
        for b in np.unique(place[visible]):
            own = visible & (place == b)
            chance[own] = detected[own].mean()
        return chance

    @cached_property
    def tags(self) -> pd.DataFrame:
        """A row for each tag: the columns of `by_tag` and three more.

        `confirmed` are the images in which it was predicted and detected, `expected` is how many these would be if it
        were like others; `stands_out` says whether it is not.
        """
        chance, cameras = self.expected, len(self.prediction.parts)
        confirmed, expected, variance = (
            images.sum(axis=0).reshape(cameras, -1).sum(axis=0)
            for images in (self.prediction.visible & self.seen.detected, chance, chance * (1.0 - chance))
        )
        spread = np.sqrt(variance)
        odd = (confirmed < expected - STANDS_OUT * spread) & (confirmed < HALF * expected)
        table = by_tag(self.prediction, self.seen)
        return table.assign(confirmed=confirmed, expected=expected, stands_out=odd)

    @cached_property
    def missed_in_a_row(self) -> BoolArray:
        """True for tags that were predicted and not detected `IN_A_ROW` times or more, one after the other, `(N, C K)`.

        Limits of a detector hardly make such misses, where a tag is well within them: something hides it, or glares.
        """
        visible, missed = self.prediction.visible, self.prediction.visible & ~self.seen.detected
        result = np.zeros_like(missed)
        for k in range(missed.shape[1]):
            frames = np.flatnonzero(visible[:, k])
            ends = np.flatnonzero(np.diff(missed[frames, k], prepend=False, append=False))
            for first, last in zip(ends[::2], ends[1::2], strict=True):
                result[frames[first:last], k] = last - first >= IN_A_ROW
        return result

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """By the names of their files."""
        return {
            "audit_pitches": by_pitch(self.prediction, self.seen),
            "audit_incidences": by_incidence(self.prediction, self.seen),
            "audit_places": by_place(self.prediction, self.seen),
            "audit_tags": self.tags,
        }

    def metrics(self) -> dict[str, float]:
        """Shares of predicted tags that were detected, and of detected ones that were predicted, and tags a frame."""
        visible, detected = self.prediction.visible, self.seen.detected
        precision, recall = precision_recall(visible, detected)
        counts = {"predicted": visible.sum(axis=1).mean(), "detected": detected.sum(axis=1).mean()}
        missed = {"missed": (visible & ~detected).sum(), "missed_in_a_row": self.missed_in_a_row.sum()}
        figures = {"precision": precision, "recall": recall, **counts, **missed}
        figures["stand_out"] = self.tags.stands_out.sum()
        return {f"audit/{name}": float(value) for name, value in figures.items() if np.isfinite(value)}

    def to_text(self) -> str:
        """What a terminal shows."""
        figures = self.metrics()
        head = (
            f"audit       {figures['audit/predicted']:.2f} tags a frame predicted, {figures['audit/detected']:.2f} "
            f"detected; {figures.get('audit/precision', np.nan):.1%} of the predicted ones were, "
            f"{figures.get('audit/recall', np.nan):.1%} of the detected ones had been predicted"
        )
        if figures["audit/missed_in_a_row"]:
            missed, runs = figures["audit/missed"], figures["audit/missed_in_a_row"]
            head += (
                f"\nmissed      {missed:.0f} times, of these {runs:.0f} in {IN_A_ROW} images of a tag in a row or more"
            )
        odd = self.tags[self.tags.stands_out]
        named = ", ".join(
            f"{row.id} (in {row.confirmed} of {row.predicted} frames, others in {row.expected:.0f})"
            for row in odd.itertuples()
        )
        return head + (f"\nstand out   {named}" if named else "")


def audited(survey: Survey, scene: Scene, verdicts: Verdicts) -> Audit:
    """Predict what the frames of a survey show of its map, in the images of all its cameras.

    Args:
        survey: of the scene's cameras.
        scene: room, cameras and visibility model; where cameras are mounted the survey knows better.
        verdicts: says which criteria a tag meets, see `lmd.evaluation.verdicts`.

    Raises:
        InputError: the scene's tag is a point.
    """
    found = survey.found
    tags = map_of(survey)
    tags = tags.hung(scene.room, anywhere=True, papers=scene.plates.papers(tags))
    room, bodies, mounts = (
        tagged_room(scene.room, tags, scene.tag),
        found.poses.frames[found.frames],
        found.poses.mounts,
    )
    parts = []
    for camera, mount, taken in zip(scene.cameras, mounts, survey.detected.images[found.frames].T, strict=True):
        poses = bodies @ mount
        seen = visible_through(scene, camera, tags, poses) & taken[:, None]
        parts.append(CameraPrediction(Renderer(camera, room), poses, seen, verdicts(scene, tags, poses, camera), taken))
    return Audit(Prediction(tuple(parts), mounts, bodies), Matches.beside(seen_of(survey)))


def in_the_open(survey: Survey, scene: Scene) -> tuple[Survey, Scene]:
    """The same where the room is not known: in an empty one around everything, in which only other tags hide a tag.

    Its z is the mean up of the tags, as the visibility model has tags hang upright.
    """
    found = survey.found
    tags = found.poses.tags[survey.placed]
    up = tags[:, :3, 1].mean(axis=0)
    up = up / np.linalg.norm(up) if np.linalg.norm(up) > LEAST_UP else np.array([0.0, 0.0, 1.0])
    right = np.cross(np.eye(3)[np.abs(up).argmin()], up)
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(up, right), up])
    places = np.concatenate([tags, found.poses.frames[found.frames]])[:, :3, 3] @ turn.T
    low, high = places.min(axis=0) - AROUND, places.max(axis=0) + AROUND
    size = tuple(map(float, high - low))
    room = Cuboid(size, reachable_size=size, spacing=max(size))  # type: ignore[arg-type]
    return replace(survey, found=found.moved(pose_of(turn, -low))), replace(scene, room=room)


def seen_of(survey: Survey) -> list[Matches]:
    """The detections of tags of the map in its frames, by each camera.

    A detection shows a tag if its corners are `CORNER_TOLERANCE` or less from where it hangs (root mean square), also
    where that is too far off to place anything.
    """
    found, some = survey.found, survey.found.sightings
    frame = np.full(some.frames, -1)
    frame[found.frames] = np.arange(len(found.frames))
    tag = np.full(len(survey.ids), -1)
    tag[survey.placed] = np.arange(survey.placed.sum())
    known = np.flatnonzero((frame[some.frame] >= 0) & survey.placed[some.tag])
    off = np.full(len(some), np.inf)
    off[known] = np.sqrt(errors_at(some.of(known), found.poses) / 4.0)
    each = []
    for camera in range(some.cameras):
        detected = np.zeros((len(found.frames), int(survey.placed.sum())), dtype=bool)
        corners = np.full((*detected.shape, 4, 2), np.nan)
        own = some.camera == camera
        right = np.flatnonzero(own & (off <= CORNER_TOLERANCE))
        right = right[np.argsort(-off[right], kind="stable")]  # of several of one tag the nearest counts
        at = frame[some.frame[right]], tag[some.tag[right]]
        detected[at], corners[at] = True, some.image[right]
        wrong = own & found.misfits & (frame[some.frame] >= 0) & (off > CORNER_TOLERANCE)
        each.append(Matches(detected, corners, np.bincount(frame[some.frame[wrong]], minlength=len(detected))))
    return each
