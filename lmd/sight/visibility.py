"""When a landmark counts as covered: the thresholds of the four criteria."""

import math
from dataclasses import dataclass

from lmd.camera import Camera
from lmd.checks import choice, real

# One tolerance for every closed inequality, so that a landmark exactly on a boundary is on it whichever way the
# number was rounded. Relative for lengths, absolute for cosines and probabilities.
TOLERANCE = 1e-9

OCCLUSION_MODES = ("paper", "line_of_sight", "none")


@dataclass(frozen=True)
class Visibility:
    """Task parameters of the visibility model (Sec. III of the paper).

    Args:
        thold: coverage-strength threshold, pixel/mm.
        nu: virtual diameter nu_k of a landmark, metres; another landmark closer than this to the line of sight
            hides it. 0 switches that test off (and lets an optimiser stack landmarks on one point).
        occlusion: `paper` tests the distance to the whole line through camera and landmark, as printed;
            `line_of_sight` only counts landmarks in front of the camera and not farther than the one looked at;
            `none` ignores other landmarks. All modes require the landmark to face the camera.
        circle_of_confusion: permissible diameter delta, pixels.

    Raises:
        InputError: a value is out of range.
    """

    thold: float
    nu: float = 0.05
    occlusion: str = "paper"
    circle_of_confusion: float = 4.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "thold", real("visibility.thold", self.thold, above=0.0))
        object.__setattr__(self, "nu", real("visibility.nu", self.nu, low=0.0))
        choice("visibility.occlusion", self.occlusion, OCCLUSION_MODES)
        confusion = real("visibility.circle_of_confusion", self.circle_of_confusion, above=0.0)
        object.__setattr__(self, "circle_of_confusion", confusion)

    @property
    def tests_other_landmarks(self) -> bool:
        """Whether one landmark can hide another."""
        return self.occlusion != "none" and self.nu > 0.0


@dataclass(frozen=True)
class Limits:
    """The criteria as bounds on the depth z = axis . (s - p), tolerance included.

    A landmark at distance d that is not occluded is covered iff
    max(min_cosine * d, min_depth) <= z <= max_depth.
    """

    min_cosine: float
    min_depth: float
    max_depth: float

    @classmethod
    def of(cls, camera: Camera, visibility: Visibility) -> "Limits":
        """Bounds for a camera; `max_depth` is the largest double that passes both focus and resolution."""
        near, far = camera.depth_of_field(visibility.circle_of_confusion)
        at_one_metre, thold = camera.resolution_at_one_metre, visibility.thold * (1.0 - TOLERANCE)
        depth = at_one_metre / thold
        # The division above may round to either side of the last depth whose strength still reaches the
        # threshold; stepping there makes the bound agree bit for bit with `strength >= threshold`.
        while at_one_metre / depth < thold:
            depth = math.nextafter(depth, 0.0)
        while at_one_metre / (further := math.nextafter(depth, math.inf)) >= thold:
            depth = further
        return cls(
            min_cosine=math.cos(camera.cone_half_angle) - TOLERANCE,
            min_depth=near * (1.0 - TOLERANCE),
            max_depth=min(depth, far * (1.0 + TOLERANCE)),
        )
