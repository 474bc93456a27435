"""Code that tells a robot's filter the standard deviations of poses measured from tags: a Java class for WPILib.

WPILib's pose estimators take the standard deviations of a measurement's x [m], y [m] and heading [rad], by
`setVisionMeasurementStdDevs` or with each `addVisionMeasurement`. The class computes these numbers. The class also has
constants for two common formulas. With n tags at the mean distance d, PhotonVision's example multiplies its constants
by 1 + d^2 / 30, and AdvantageKit's template multiplies its constants by d^2 / n. There are no constants for Limelight,
which publishes standard deviations of its own and accepts none.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lmd.core.checks import InputError
from lmd.estimation.deviation_law import Law, PowerLaw, Rule

CLASS = "VisionUncertainty"


@dataclass(frozen=True)
class FilterLaws:
    """Uncertainty laws for which code is written.

    A law gives the standard deviation of a measured pose as a function of the distance and the number of the tags in
    view (`lmd.estimation.deviation_law`).
    """

    laws: Mapping[str, Law]
    """Laws for the standard deviations of the position (`horizontal`, `vertical`) and of the rotation (`tilt`,
    `heading`), keyed by these names.
    """
    rules: Mapping[str, Mapping[str, Rule]]
    """Common simple formulas ("rules") for the standard deviations of `horizontal` position and `heading`: for each of
    these keys, the rules `squared` and `photonvision`.
    """
    reach: float
    """Distance of a single tag above which the pose that it gives is ambiguous, metres; infinite without a limit."""
    nearest: float
    """Smallest distance of the views to which the laws were fitted, metres; the distance of a view is the mean distance
    of the tags in it.
    """
    farthest: float
    """Greatest distance of the views to which the laws were fitted, metres."""
    about: str
    """Description of the room, the tags and the camera, on one line."""

    def __post_init__(self) -> None:
        if "\n" in self.about:
            raise InputError("about must be a single line.", "about")


def _number(value: float) -> str:
    return f"{value:.5g}" if "." in f"{value:.5g}" or "e" in f"{value:.5g}" else f"{value:.5g}.0"


def _row(law: PowerLaw) -> str:
    return ", ".join(_number(value) for value in (law.scale, law.distance, law.tags))


def java(laws: FilterLaws) -> str:
    """Text of a Java class for WPILib that computes the standard deviations of measured poses by the given `laws`."""
    h, t = laws.laws["horizontal"], laws.laws["heading"]
    squared, photon = laws.rules["squared"], laws.rules["photonvision"]
    reach = "Double.POSITIVE_INFINITY" if np.isinf(laws.reach) else _number(laws.reach)
    return f"""\
package frc.robot;

import edu.wpi.first.math.Matrix;
import edu.wpi.first.math.VecBuilder;
import edu.wpi.first.math.numbers.N1;
import edu.wpi.first.math.numbers.N3;

/**
 * Standard deviations of a pose from tags in one image, for setVisionMeasurementStdDevs and addVisionMeasurement.
 *
 * <p>{laws.about}
 */
public final class {CLASS} {{
  // Scale, exponent of the distance [m], exponent of the number of tags.
  private static final double[] ONE_POSITION = {{{_row(h.one)}}}; // metres
  private static final double[] ONE_HEADING = {{{_row(t.one)}}}; // radians
  private static final double[] SEVERAL_POSITION = {{{_row(h.several)}}};
  private static final double[] SEVERAL_HEADING = {{{_row(t.several)}}};
  private static final double NEAREST = {_number(laws.nearest)}; // metres
  private static final double FARTHEST = {_number(laws.farthest)};

  /** Distance [m] above which the pose from a single tag is ambiguous. */
  public static final double SINGLE_TAG_REACH = {reach};

  // For code that keeps the formula of PhotonVision's example: times 1 + distance * distance / 30.
  public static final Matrix<N3, N1> kSingleTagStdDevs =
      VecBuilder.fill({_triple(photon, "one")});
  public static final Matrix<N3, N1> kMultiTagStdDevs =
      VecBuilder.fill({_triple(photon, "several")});
  // For code that keeps the formula of AdvantageKit's template: times distance * distance / tags.
  public static final double linearStdDevBaseline = {_number(squared["horizontal"].several)};
  public static final double angularStdDevBaseline = {_number(squared["heading"].several)};

  private {CLASS}() {{}}

  /**
   * Standard deviations of x [m], y [m] and heading [rad].
   *
   * @param distance mean distance from the camera to the tags in view, metres
   * @param tags number of tags in view
   */
  public static Matrix<N3, N1> stdDevs(double distance, int tags) {{
    if (tags < 1 || (tags == 1 && distance > SINGLE_TAG_REACH)) {{
      return VecBuilder.fill(Double.MAX_VALUE, Double.MAX_VALUE, Double.MAX_VALUE);
    }}
    double position = law(tags == 1 ? ONE_POSITION : SEVERAL_POSITION, distance, tags);
    double heading = law(tags == 1 ? ONE_HEADING : SEVERAL_HEADING, distance, tags);
    return VecBuilder.fill(position, position, heading);
  }}

  private static double law(double[] law, double distance, int tags) {{
    double at = Math.min(Math.max(distance, NEAREST), FARTHEST);
    return law[0] * Math.pow(at, law[1]) / Math.pow(tags, law[2]);
  }}
}}
"""


def _triple(rules: Mapping[str, Rule], group: str) -> str:
    position, heading = (_number(getattr(rules[name], group)) for name in ("horizontal", "heading"))
    return f"{position}, {position}, {heading}"
