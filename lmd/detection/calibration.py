"""Limits of a detector fitted to views of tags, and how well they predict what they were not fitted to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.detection.detectors import Detector
from lmd.detection.evaluation import TAG_NUMBERS, agreement, at_least, precision_recall
from lmd.detection.fit import Fit
from lmd.detection.frames import Sightings, overlapping, qualities
from lmd.detection.mosaic import Views
from lmd.geometry.camera import Camera
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.scene.tag import Tag
from lmd.sight.models.limits import NAMES, Limits, Preset

INTERVAL_ENDS = ("low", "high")


class Source(Protocol):
    """Where views of tags come from whose outcome is known."""

    @property
    def photographs(self) -> int:
        """How many photographs they are of; 0 where they are rendered."""

    def views(
        self, cameras: Sequence[Camera], tag: Tag, detector: Detector, imaging: Imaging, rng: np.random.Generator
    ) -> Views:
        """Views and what the detector made of them.

        Args:
            cameras: that take the images; several where they are those of a rig.
            tag: its family, size and quiet zone.
            detector: for this family.
            imaging: lens and light, where images are rendered; blur, where they are read.
            rng: source of everything random.

        Raises:
            InputError: it makes views for one camera only, or of other cameras.
        """


def foreseen(limits: Limits, renderer: Renderer, poses: FloatArray) -> BoolArray:
    """Which tags the limits predict to be found in frames, `(N, K)`.

    Args:
        limits: of a single tag.
        renderer: the camera and the tags; those that overlap another one are taken as not found.
        poses: X, `(N, 4, 4)`.
    """
    found = limits.found(*qualities(renderer, poses)) & renderer.inside(poses, limits.margin)
    return np.asarray(found & ~overlapping(renderer.room))


@dataclass(frozen=True)
class Calibration:
    """Limits of one detector and the evidence.

    Args:
        views: that they come from.
        fit: the limits, judged on the half of the views that they were not fitted to.
        rooms: judged on whole frames: `predicted_<n>` and `detected_<n>`, P(>= n), `agreement_2`, `precision`,
            `recall`; empty where there were none.
        photographs: that the views are of; 0 where they were rendered.
        intervals: in which nine of ten limits lie that are fitted to as many views drawn from these, by name; empty
            where that was not asked for.
    """

    views: Views
    fit: Fit
    rooms: dict[str, float]
    photographs: int = 0
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def figures(self) -> dict[str, float]:
        """Everything as one row."""
        limits, fit = self.fit.limits, self.fit
        return {
            "views": len(self.views),
            "seen": float(self.views.seen.mean()),
            **{name: getattr(limits, name) for name in NAMES},
            **{name: getattr(fit, name) for name in ("accuracy", "precision", "recall")},
            **{f"image_circle_{number}": diameter for number, diameter in fit.known_circles.items()},
            **{
                f"{name}_{end}": value
                for name, ends in self.intervals.items()
                for end, value in zip(INTERVAL_ENDS, ends, strict=True)
            },
            "photographs": self.photographs,
            **{f"room_{name}": value for name, value in self.rooms.items()},
        }

    def preset(self, detector: str, family: str, source: str) -> str:
        """The limits as a preset's file, with the evidence as comments.

        Args:
            source: where the views come from.
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
        if self.intervals:
            spans = (f"{name} {low:.3g} to {high:.3g}" for name, (low, high) in self.intervals.items())
            lines.append(f"90 % intervals: {', '.join(spans)}.")
        if self.rooms:
            pairs = (f"{self.rooms[f'predicted_{n}']:.3f} / {self.rooms[f'detected_{n}']:.3f}" for n in TAG_NUMBERS)
            lines.append(
                f"In {self.rooms['frames']:.0f} frames of a room: P(>= 1..4) predicted / detected {', '.join(pairs)}; "
                f"precision {self.rooms['precision']:.3f}, recall {self.rooms['recall']:.3f}; "
                f"{self.rooms['agreement_2']:.1%} of the frames agree on >= 2."
            )
        return Preset(detector, family, fit.limits).to_yaml(lines)


def judged(predicted: BoolArray, seen: Sightings) -> dict[str, float]:
    """`Calibration.rooms` of frames.

    Args:
        predicted: `(N, K)`.
        seen: what the detector found in them.
    """
    precision, recall = precision_recall(predicted, seen.detected)
    row = {"frames": float(len(predicted)), "precision": float(precision), "recall": float(recall)}
    for name, which in (("predicted", predicted), ("detected", seen.detected)):
        row |= {f"{name}_{n}": float(share) for n, share in zip(TAG_NUMBERS, at_least(which).share, strict=True)}
    return row | {"agreement_2": agreement(predicted, seen.detected)}
