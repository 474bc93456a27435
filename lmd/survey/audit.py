"""What a visibility model predicts for the frames of a survey, beside what was really detected in them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from lmd.core.checks import BoolArray, FloatArray
from lmd.detection.evaluation import precision_recall
from lmd.detection.frames import Sightings, tagged_room
from lmd.detection.report import PITCHES, Prediction, by_incidence, by_pitch, by_place, by_tag
from lmd.geometry.se3 import axis_and_right
from lmd.problem import Problem
from lmd.render.renderer import Renderer
from lmd.scene.deployment import Deployment
from lmd.scene.scene import Scene
from lmd.sight.views import visible
from lmd.survey.report import map_of
from lmd.survey.survey import Survey

# A tag stands out that is detected so many standard deviations less often than others of its pitch, and half as often.
STANDS_OUT, HALF = 4.0, 0.5

Verdicts = Callable[[Scene, Deployment, FloatArray], dict[str, BoolArray]]


@dataclass(frozen=True)
class Audit:
    """N frames of a survey, and the K tags of its map.

    Args:
        prediction: what was predicted of them.
        seen: what was detected; false are detections that do not show a tag where it hangs.
    """

    prediction: Prediction
    seen: Sightings

    @cached_property
    def expected(self) -> FloatArray:
        """The chance of each tag to be detected if it is like others of its pitch, `(N, K)`; 0 if not predicted."""
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

        `confirmed` are the frames in which it was predicted and detected, `expected` is how many these would be if it
        were like others; `stands_out` says whether it is not.
        """
        confirmed = (self.prediction.visible & self.seen.detected).sum(axis=0)
        expected, spread = self.expected.sum(axis=0), np.sqrt((self.expected * (1.0 - self.expected)).sum(axis=0))
        odd = (confirmed < expected - STANDS_OUT * spread) & (confirmed < HALF * expected)
        table = by_tag(self.prediction, self.seen)
        return table.assign(confirmed=confirmed, expected=expected, stands_out=odd)

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
        figures = {"precision": precision, "recall": recall, **counts, "stand_out": self.tags.stands_out.sum()}
        return {f"audit/{name}": float(value) for name, value in figures.items() if np.isfinite(value)}

    def to_text(self) -> str:
        """What a terminal shows."""
        figures = self.metrics()
        head = (
            f"audit       {figures['audit/predicted']:.2f} tags a frame predicted, {figures['audit/detected']:.2f} "
            f"detected; {figures.get('audit/precision', np.nan):.1%} of the predicted ones were, "
            f"{figures.get('audit/recall', np.nan):.1%} of the detected ones had been predicted"
        )
        odd = self.tags[self.tags.stands_out]
        named = ", ".join(
            f"{row.id} (in {row.confirmed} of {row.predicted} frames, others in {row.expected:.0f})"
            for row in odd.itertuples()
        )
        return head + (f"\nstand out   {named}" if named else "")


def audited(survey: Survey, problem: Problem, verdicts: Verdicts) -> Audit:
    """Predict what the frames of a survey show of its map.

    Args:
        survey: of one camera.
        problem: has the room and the visibility model.
        verdicts: says which criteria a tag meets, see `lmd.evaluation.verdicts`.

    Raises:
        InputError: the problem has a rig, or its tag is a point.
    """
    scene = problem.scene
    camera = scene.single_camera("audit")
    tags = map_of(survey)
    tags = tags.hung(scene.room, anywhere=True, papers=scene.plates.papers(tags))
    found = survey.found
    poses = found.poses.frames[found.frames]
    predicted = visible(problem.evaluator, tags, poses[:, :3, 3], axis_and_right(poses))
    renderer = Renderer(camera, tagged_room(scene.room, tags, scene.tag))
    prediction = Prediction(renderer, poses, predicted, verdicts(scene, tags, poses))
    return Audit(prediction, seen_of(survey))


def seen_of(survey: Survey) -> Sightings:
    """What was detected of the tags of the map in its frames."""
    found, some = survey.found, survey.found.sightings
    frame = np.full(some.frames, -1)
    frame[found.frames] = np.arange(len(found.frames))
    tag = np.full(len(survey.ids), -1)
    tag[survey.placed] = np.arange(survey.placed.sum())
    detected = np.zeros((len(found.frames), int(survey.placed.sum())), dtype=bool)
    corners = np.full((*detected.shape, 4, 2), np.nan)
    own = found.used & survey.placed[some.tag]
    at = frame[some.frame[own]], tag[some.tag[own]]
    detected[at], corners[at] = True, some.image[own]
    false = np.bincount(frame[some.frame[found.misfits & (frame[some.frame] >= 0)]], minlength=len(found.frames))
    return Sightings(detected, corners, false)
