"""Limits of a detector fitted to views of tags, and how well they predict what they were not fitted to."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lmd.camera import Camera
from lmd.checks import BoolArray, FloatArray
from lmd.detection.detectors import Detector
from lmd.detection.evaluation import NUMBERS, agreement, at_least, precision_recall
from lmd.detection.fit import Fit, Limits
from lmd.detection.frames import Sightings, overlapping, qualities
from lmd.detection.mosaic import Views
from lmd.render.imaging import Imaging
from lmd.render.renderer import Renderer
from lmd.tag import Tag


class Source(Protocol):
    """Where views of tags come from whose outcome is known."""

    def views(self, camera: Camera, tag: Tag, detector: Detector, imaging: Imaging, rng: np.random.Generator) -> Views:
        """Views and what the detector made of them.

        Args:
            camera: that takes the images.
            tag: its family, size and quiet zone.
            detector: for this family.
            imaging: lens and light, where images are rendered; blur and distortion, where they are read.
            rng: source of everything random.
        """


def foreseen(limits: Limits, renderer: Renderer, poses: FloatArray, border: float) -> BoolArray:
    """Which tags the limits predict to be found in frames, `(N, K)`.

    Args:
        limits: of a single tag.
        renderer: the camera and the tags; those that overlap another one are taken as not found.
        poses: X, `(N, 4, 4)`.
        border: least distance of the corners from the image's border, pixels.
    """
    found = limits.found(*qualities(renderer, poses)) & renderer.inside(poses, border)
    return np.asarray(found & ~overlapping(renderer.room))


@dataclass(frozen=True)
class Calibration:
    """Limits of one detector and the evidence.

    Args:
        views: that they come from.
        fit: the limits, judged on the half of the views that they were not fitted to.
        rooms: judged on whole frames: `predicted_<n>` and `detected_<n>`, P(>= n), `agreement_2`, `precision`,
            `recall`; empty where there were none.
    """

    views: Views
    fit: Fit
    rooms: dict[str, float]

    def figures(self) -> dict[str, float]:
        """Everything as one row."""
        limits, fit = self.fit.limits, self.fit
        return {
            "views": len(self.views),
            "seen": float(self.views.seen.mean()),
            **{name: getattr(limits, name) for name in ("pitch", "blur", "edge", "incidence")},
            **{name: getattr(fit, name) for name in ("accuracy", "precision", "recall")},
            **{f"room_{name}": value for name, value in self.rooms.items()},
        }

    def preset(self, heading: str) -> str:
        """The limits as YAML, with the evidence as comments.

        Args:
            heading: what they are the limits of, lines without `#`.
        """
        limits, fit = self.fit.limits, self.fit
        lines = heading.splitlines()
        lines.append(
            f"Fitted to half of {len(self.views)} views; on the other half accuracy {fit.accuracy:.3f}, "
            f"precision {fit.precision:.3f}, recall {fit.recall:.3f}."
        )
        if self.rooms:
            pairs = (f"{self.rooms[f'predicted_{n}']:.3f} / {self.rooms[f'detected_{n}']:.3f}" for n in NUMBERS)
            lines.append(
                f"In {self.rooms['frames']:.0f} frames of a room: P(>= 1..4) predicted / detected {', '.join(pairs)}; "
                f"precision {self.rooms['precision']:.3f}, recall {self.rooms['recall']:.3f}; "
                f"{self.rooms['agreement_2']:.1%} of the frames agree on >= 2."
            )
        return "".join(f"# {line}\n" for line in lines) + (
            "_target_: lmd.detection.fit.Limits\n"
            f"pitch: {limits.pitch:.4g}  # a, pixels a module in a sharp image\n"
            f"blur: {limits.blur:.4g}  # k, pixels a module for each pixel of sigma\n"
            f"edge: {limits.edge:.4g}  # m, area-equivalent edge, pixels\n"
            f"incidence: {limits.incidence:.4g}  # b, rad: {np.degrees(limits.incidence):.0f} degrees\n"
        )


def judged(predicted: BoolArray, seen: Sightings) -> dict[str, float]:
    """`Calibration.rooms` of frames.

    Args:
        predicted: `(N, K)`.
        seen: what the detector found in them.
    """
    precision, recall = precision_recall(predicted, seen.detected)
    row = {"frames": float(len(predicted)), "precision": float(precision), "recall": float(recall)}
    for name, which in (("predicted", predicted), ("detected", seen.detected)):
        row |= {f"{name}_{n}": float(share) for n, share in zip(NUMBERS, at_least(which).share, strict=True)}
    return row | {"agreement_2": agreement(predicted, seen.detected)}
