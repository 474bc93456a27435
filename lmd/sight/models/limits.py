"""Limits of a detector: least pitch, size and margin, and greatest incidence angle, at which the detector finds a tag.

A preset is a YAML file with the keys `detector`, `family` and the fields of `Limits`; comments give the evidence.
`lmd/sight/models/presets` has the presets of the package; `pipelines.calibrate_detector` writes new presets.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from lmd.core.checks import BoolArray, Checked, FloatArray, InputError, NotNegative, argument_of, choice, real, said_of
from lmd.core.files import read_keys
from lmd.scene.families import family_named

FOLDER = Path(__file__).parent / "presets"
SUFFIXES = (".yaml", ".yml")


@dataclass(frozen=True)
class Limits(Checked):
    """Limits within which a detector finds a tag.

    Args:
        pitch: least pitch (image length of a module) in an image without blur, pixels per module. Called a in presets.
        blur: increase of the least pitch with the blur sigma, in pixels: the least pitch is sqrt(pitch^2 + (blur
            sigma)^2). Called k in presets.
        edge: least square root of the image area, pixels. Called m in presets.
        incidence: greatest angle between the tag's normal and the direction to the camera, degrees. Called b in
            presets.
        margin: least distance of the corners from the image's border, pixels.

    Raises:
        InputError: a value is out of range.
    """

    pitch: NotNegative
    blur: NotNegative
    edge: NotNegative
    incidence: Annotated[float, partial(real, above=0.0, high=89.0)]
    margin: NotNegative

    def found(self, pitch: FloatArray, incidence: FloatArray, edge: FloatArray, sigma: FloatArray) -> BoolArray:
        """Mask of the views in which the detector finds the tag, for tags wholly in the image.

        All arrays have one shape. NaN marks a view with the tag behind the camera; there, the result is False.

        Args:
            pitch: pitch, pixels per module.
            incidence: incidence angle, rad.
            edge: square root of the image area, pixels.
            sigma: standard deviation of the total blur, pixels.
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
    """Measured limits of a detector for a family of tags.

    Args:
        detector: name of the detector.
        family: name of a family of tags, or the common prefix of several families, such as `4x4`.
        limits: the measured limits.
    """

    detector: str
    family: str
    limits: Limits

    def to_yaml(self, evidence: Sequence[str]) -> str:
        """Text of the YAML file; the lines of `evidence` (without `#`) precede the keys as comments."""
        lines = [*(f"# {line}" for line in evidence), f"detector: {self.detector}", f"family: {self.family}"]
        lines += [f"{name}: {getattr(self.limits, name):.4g}  # {MEANING[name]}" for name in NAMES]
        return "".join(f"{line}\n" for line in lines)

    @classmethod
    def from_yaml(cls, path: str | Path) -> "Preset":
        """Read a preset from a YAML file.

        Raises:
            InputError: the file cannot be read, a key is missing or unknown, or a value is out of range.
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
    """Presets of this package, keyed by (detector, family)."""
    presets = [Preset.from_yaml(path) for path in sorted(FOLDER.iterdir()) if path.suffix in SUFFIXES]
    return {(preset.detector, preset.family): preset for preset in presets}


def limits_of(detector: str, family: str, changes: Mapping[str, Any]) -> Limits:
    """Limits of a detector for a family of tags.

    Args:
        detector: name of a measured detector, or the path of a preset.
        family: one of `lmd.scene.families.FAMILIES`.
        changes: values that replace single limits; without a preset for detector and family, `changes` must give all
            limits.

    Raises:
        InputError: there is no preset for detector and family, or `changes` has an unknown key.
    """
    for name in changes:
        choice("limits", name, NAMES)
    kind = family.partition("_")[0] if family[0].isdigit() else family
    known: Preset | None
    if str(detector).endswith(SUFFIXES):
        known = Preset.from_yaml(detector)
        if known.family not in (family, kind):
            message = f"detector: {detector!r} is for tags of the family {known.family}, not {family}."
            raise InputError(message, "detector")
    else:
        known = measured().get((detector, kind))
    with argument_of("limits"):
        if known is not None:
            return replace(known.limits, **changes)
        if set(changes) == set(NAMES):
            return Limits(**changes)
    families: dict[str, list[str]] = {}
    for name, own in measured():
        families.setdefault(name, []).append(own)
    pairs = "; ".join(f"{name} with {', '.join(own)}" for name, own in families.items())
    others = "".join(f"; or choose detector={name}" for name, own in families.items() if kind in own)
    raise InputError(
        f"detector {detector} was not measured with tags of family {family} (measured: {pairs}), "
        f"so limits must give {', '.join(NAMES)}{others}.",
        "detector",
    )
