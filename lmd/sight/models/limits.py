"""What a detector needs of a tag: `Limits`, and the presets that hold those which were measured.

A preset is a YAML file with the keys `detector`, `family` and those of `Limits`, and with its evidence as comments.
`lmd/sight/models/presets` has some; `pipelines.calibrate_detector` writes more of the same kind.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, argument_of, check_fields, choice, real, said_of
from lmd.core.files import read_keys
from lmd.scene.families import family_named

FOLDER = Path(__file__).parent / "presets"
SUFFIXES = (".yaml", ".yml")


@dataclass(frozen=True)
class Limits:
    """What a tag must be like for a detector to find it; the terms are those of `lmd.detection.quality`.

    Args:
        pitch: a, least pixels a module without blur.
        blur: k, how many more for each pixel of blur: the least pitch is sqrt(pitch^2 + (blur sigma)^2).
        edge: m, least edge of the square of the same area, pixels.
        incidence: b, greatest angle between the tag's normal and the direction to the camera, degrees.
        margin: least distance of the corners from the image's border, pixels.

    Raises:
        InputError: a value is out of range.
    """

    pitch: float
    blur: float
    edge: float
    incidence: float
    margin: float

    def __post_init__(self) -> None:
        check_fields(self, real, "pitch", "blur", "edge", "margin", low=0.0)
        check_fields(self, real, "incidence", above=0.0, high=89.0)

    def found(self, pitch: FloatArray, incidence: FloatArray, edge: FloatArray, sigma: FloatArray) -> BoolArray:
        """Whether views wholly in the image are found, arrays of one shape; NaN (behind the camera) is not.

        Args:
            pitch: pixels a module.
            incidence: rad.
            edge: pixels.
            sigma: standard deviation of the whole blur, pixels.
        """
        least = np.hypot(self.pitch, self.blur * sigma)
        return np.asarray((pitch >= least) & (edge >= self.edge) & (incidence <= math.radians(self.incidence)))


NAMES = tuple(field.name for field in fields(Limits))
MEANING = {
    "pitch": "a, pixels a module in a sharp image",
    "blur": "k, pixels a module for each pixel of blur",
    "edge": "m, edge of the square of the same area, pixels",
    "incidence": "b, degrees",
    "margin": "of the corners from the image's border, pixels",
}


@dataclass(frozen=True)
class Preset:
    """Limits with what they were measured of.

    Args:
        detector: its name.
        family: of tags, or what the names of several families begin with: `4x4`.
        limits: of the two.
    """

    detector: str
    family: str
    limits: Limits

    def to_yaml(self, evidence: Sequence[str]) -> str:
        """The file, with lines of `evidence` (without `#`) before it."""
        lines = [*(f"# {line}" for line in evidence), f"detector: {self.detector}", f"family: {self.family}"]
        lines += [f"{name}: {getattr(self.limits, name):.4g}  # {MEANING[name]}" for name in NAMES]
        return "".join(f"{line}\n" for line in lines)

    @classmethod
    def from_yaml(cls, path: str | Path) -> "Preset":
        """Read a file.

        Raises:
            InputError: it cannot be read, a key is missing or unknown, or a value is out of range.
        """
        keys = read_keys(path, "detector")
        expected = {"detector", "family", *NAMES}
        if set(keys) != expected:
            asked = f"detector, family, {', '.join(NAMES)}"
            raise InputError(f"detector: {str(path)!r} must have the keys {asked} and no others.", "detector")
        with said_of(f"detector: {str(path)!r}", "detector"):
            limits = Limits(**{name: keys[name] for name in NAMES})
            return cls(str(keys["detector"]), family_named(str(keys["family"])), limits)


@cache
def measured() -> dict[tuple[str, str], Preset]:
    """The presets of this package by detector and family."""
    presets = [Preset.from_yaml(path) for path in sorted(FOLDER.iterdir()) if path.suffix in SUFFIXES]
    return {(preset.detector, preset.family): preset for preset in presets}


def limits_of(detector: str, family: str, changes: Mapping[str, Any]) -> Limits:
    """The limits of a detector for a family of tags.

    Args:
        detector: one that was `measured`, or a preset's file.
        family: of `lmd.scene.families.FAMILIES`.
        changes: what differs; all of `Limits` for a detector and a family without a preset.

    Raises:
        InputError: the detector is not known with this family, or a change is none of `Limits`.
    """
    for name in changes:
        choice("limits", name, NAMES)
    kind = family.partition("_")[0] if family[0].isdigit() else family
    known: Preset | None
    if str(detector).endswith(SUFFIXES):
        known = Preset.from_yaml(detector)
        if known.family not in (family, kind):
            message = f"detector: {detector!r} is about tags of the family {known.family}, not {family}."
            raise InputError(message, "detector")
    else:
        known = measured().get((detector, kind))
    with argument_of("limits"):
        if known is not None:
            return replace(known.limits, **changes)
        if set(changes) == set(NAMES):
            return Limits(**changes)
    pairs = ", ".join(" with ".join(pair) for pair in measured())
    raise InputError(
        f"detector {detector} was not measured with tags of family {family}, only {pairs}; "
        f"limits must give {', '.join(NAMES)}.",
        "detector",
    )
