"""Pictures that compare detections with predictions: charts, and frames in which the tags are outlined."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from lmd.core.checks import BoolArray, FloatArray
from lmd.core.optional import optional
from lmd.detection.calibration import DetectorCalibration, predicted_views
from lmd.detection.detectors import TAG_NUMBERS
from lmd.plot.common import dress, literal, new_panels, set_ticks, shrink
from lmd.render.imaging import UInt8Array

# Colours of outlines in frames: red, green, blue.
BOTH, ONLY_DETECTED, ONLY_PREDICTED = (26, 150, 65), (31, 119, 220), (214, 39, 40)
# Bounds of the classes of the ratio of a tag's size to its limit.
RATIOS = np.arange(0.3, 2.51, 0.1)
PITCH_TICKS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
LEGEND = (
    (BOTH, "predicted and detected"),
    (ONLY_DETECTED, "detected, not predicted"),
    (ONLY_PREDICTED, "predicted, not detected"),
)


def save_calibration_figure(path: str | Path, figures: pd.DataFrame, pitches: pd.DataFrame, title: str) -> None:
    """Write a PNG with two panels for each deployment, which compare predictions with detections.

    The upper panel shows, against n, the predicted and the detected share of frames with at least n tags. The lower
    panel shows, against the pitch (pixels per module), the predicted and the detected share of tags.

    Args:
        path: path of the PNG.
        figures: rows of `lmd.detection.predictions.figures` with the columns `deployment` and `detector`.
        pitches: rows of `lmd.detection.predictions.by_pitch` with the columns `deployment` and `detector`.
        title: title of the figure.
    """
    names, detectors = list(figures.deployment.unique()), list(figures.detector.unique())
    figure, panels = new_panels((2.0 + 5.0 * len(names), 9.0), title, 2, len(names), sharey="row")
    width = 0.8 / (1 + len(detectors))
    for axes, name in zip(panels[0], names, strict=True):
        rows = figures[figures.deployment == name].set_index("detector")
        bars = [("predicted", rows.iloc[0], "predicted", "#9e9e9e")]
        bars += [(detector, rows.loc[detector], "detected", f"C{i}") for i, detector in enumerate(detectors)]
        for i, (label, row, which, colour) in enumerate(bars):
            share, error = ([row[f"{which}_{n}{end}"] for n in TAG_NUMBERS] for end in ("", "_error"))
            at = TAG_NUMBERS + (i - len(detectors) / 2.0) * width
            axes.bar(at, share, width, yerr=error, color=colour, label=literal(label), error_kw={"lw": 1.0})
        axes.set(title=literal(name), xticks=TAG_NUMBERS, xticklabels=[f"≥ {n}" for n in TAG_NUMBERS], ylim=(0.0, 1.02))
        axes.set_xlabel("tags in a frame")
        axes.grid(axis="y", alpha=0.3)
    for axes, name in zip(panels[1], names, strict=True):
        for i, detector in enumerate(detectors):
            rows = pitches[(pitches.deployment == name) & (pitches.detector == detector)]
            if i == 0:
                axes.plot(_middle(rows), rows.predicted, "o--", color="#9e9e9e", label="predicted")
            axes.plot(_middle(rows), rows.detected, "o-", color=f"C{i}", label=literal(detector))
        dress(axes, xscale="log", xlabel="pixels a module, tags wholly in the image", ylim=(-0.02, 1.02))
        set_ticks(axes.xaxis, np.array(PITCH_TICKS))
        axes.set_xlim(PITCH_TICKS[0], PITCH_TICKS[-1])
    panels[0][0].set_ylabel("share of frames")
    panels[1][0].set_ylabel("share of tags")
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    figure.savefig(path)


def save_limits_figure(path: str | Path, calibrations: Mapping[str, DetectorCalibration], title: str) -> None:
    """Write a PNG with two panels for each detector, which compare detections with the detector's limits.

    The left panel shows the views of tags, detected or not, against blur and pitch (pixels per module). The right panel
    shows the share of views in which the tag was detected, against the ratio of the tag's size to the detector's limit.

    Args:
        path: path of the PNG.
        calibrations: calibrations of the detectors' limits, keyed by the name of the detector.
        title: title of the figure.
    """
    figure, panels = new_panels((12.0, 0.6 + 4.2 * len(calibrations)), title, len(calibrations), 2)
    for (left, right), (name, calibration) in zip(panels, calibrations.items(), strict=True):
        views, limits = calibration.views, calibration.fit.limits
        facing = replace(limits, pitch=0.0, blur=0.0, edge=0.0)  # limits of incidence and margin alone
        shown = predicted_views(views, facing, calibration.fit.circles)
        fair = shown & (views.edge >= limits.edge)
        for which, colour, label in ((views.seen, "C0", "found"), (~views.seen, "C3", "not found")):
            chosen = fair & which
            left.plot(views.sigma[chosen], views.pitch[chosen], ".", ms=3.0, alpha=0.5, color=colour, label=label)
        sigma = np.linspace(views.sigma.min(), views.sigma.max(), 100)
        left.plot(sigma, np.hypot(limits.pitch, limits.blur * sigma), "k", label="limit")
        left.set(title=literal(name), xlabel="blur sigma [px]", ylabel="pixels a module", ylim=(0.0, None))
        left.legend(loc="upper left", markerscale=3.0, framealpha=0.9)
        with np.errstate(divide="ignore"):  # a limit of 0 is no limit
            least = np.hypot(limits.pitch, limits.blur * views.sigma)
            ratio = np.minimum(views.pitch / least, views.edge / np.float64(limits.edge))
        place = np.searchsorted(RATIOS, ratio, side="right") - 1
        for b in range(len(RATIOS) - 1):
            members = views.seen[shown & (place == b)]
            if len(members):
                share = members.mean()
                error = np.sqrt(share * (1.0 - share) / len(members))
                right.errorbar((RATIOS[b] + RATIOS[b + 1]) / 2.0, share, error, fmt="o", color="C0")
        right.plot([RATIOS[0], 1.0, 1.0, RATIOS[-1]], [0.0, 0.0, 1.0, 1.0], "k", lw=1.0)
        dress(right, xlabel="size over the limit", ylabel="share found", ylim=(-0.02, 1.02))
    figure.savefig(path)


def _middle(rows: pd.DataFrame) -> FloatArray:
    """Geometric mean of the lower and the upper limit of each bin of pitches, `(B,)`, pixels per module."""
    low, high = (rows[name].to_numpy(np.float64) for name in ("pitch_from", "pitch_to"))
    low = np.where(low > 0.0, low, high / 1.5)
    return np.asarray(np.sqrt(low * np.where(np.isfinite(high), high, 1.5 * low)))


def outlined(image: UInt8Array, expected: FloatArray, predicted: BoolArray, found: FloatArray) -> UInt8Array:
    """Draw outlines around the tags that were predicted or detected; return the image with the outlines, `(h, w, 3)`.

    Args:
        image: grey image, `(h, w)`.
        expected: exact corners of the K tags, pixels from the top-left border, `(K, 4, 2)`; NaN behind the camera.
        predicted: mask of the predicted tags, `(K,)`.
        found: detected corners, `(K, 4, 2)`; NaN for tags that were not detected.
    """
    cv2 = optional("cv2", "detection")
    drawn = np.repeat(image[..., None], 3, axis=-1)
    detected = np.asarray(np.isfinite(found).all(axis=(1, 2)))
    for k in np.flatnonzero(predicted | detected):
        colour = ONLY_PREDICTED if not detected[k] else BOTH if predicted[k] else ONLY_DETECTED
        square = found[k] if detected[k] else expected[k]
        if np.isfinite(square).all():
            centre = square.mean(axis=0)
            wider = np.rint(centre + 1.25 * (square - centre) - 0.5).astype(np.int32)
            cv2.polylines(drawn, [wider], True, colour, 2 * _scale(image), cv2.LINE_AA)
    return drawn


def save_frame(
    path: str | Path, image: UInt8Array, expected: FloatArray, predicted: BoolArray, found: FloatArray
) -> None:
    """Write a PNG of an image with outlined tags and a legend; arguments as in `outlined`."""
    cv2 = optional("cv2", "detection")
    drawn, scale = outlined(image, expected, predicted, found), _scale(image)
    for i, (colour, text) in enumerate(LEGEND):
        at = (10 * scale, (18 + 18 * i) * scale)
        cv2.putText(drawn, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5 * scale, (255, 255, 255), 4 * scale, cv2.LINE_AA)
        cv2.putText(drawn, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5 * scale, colour, scale, cv2.LINE_AA)
    cv2.imwrite(str(path), drawn[..., ::-1])
    shrink(path)


def _scale(image: UInt8Array) -> int:
    """Factor for the widths of drawn lines; it is 1 for an image that is 800 pixels wide."""
    return max(1, round(len(image[0]) / 800))
