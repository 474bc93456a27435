"""Where detectors find corners: common offset, and shift towards the tag's middle, in images that lmd did not render.

python benchmarks/corners.py rendered [--tags 60]    # every detector, by pitch, blur and exposure
python benchmarks/corners.py preset [--tags 60]      # `inward` and `inward_spread` of lmd.detection.corner_errors
python benchmarks/corners.py photographs FOLDER FAMILY   # beside lines fitted to the edges of photographed tags

A rendered pixel is the mean of 8 x 8 samples of a tag under a random homography, after a Gaussian blur of the samples.
Figures are pixels from the border of the image (the middle of the first pixel is 0.5).
"""

import argparse
from itertools import product
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.optimize import least_squares
from scipy.special import erf

from lmd.core.checks import FloatArray
from lmd.detection.corner_errors import PITCH_MIDDLES
from lmd.detection.detectors import AprilTagDetector, ArucoDetector, Detections, Detector
from lmd.render.imaging import UInt8Array

SAMPLES = 8  # along each side of a pixel
PITCHES = (1.5, 2.0, 3.0, 4.5, 6.0, 9.0, 12.0)  # pixels a module
BLURS = (0.0, 0.5, 1.0, 1.5)  # sigma of the point spread function, pixels
# Levels of black and white paper in the sensor's linear scale, and the exponent of its tone curve; above 1 it clips.
EXPOSURES = {
    "linear": (0.15, 0.80, 1.0),
    "dark": (0.03, 0.25, 1.0),
    "tone curve 1/2.2": (0.05, 0.80, 1 / 2.2),
    "white at 1.5 x full": (0.10, 1.50, 1.0),
}
ORDINARY = "linear"
DETECTORS: dict[str, Detector] = {
    "aruco": ArucoDetector(),
    "aruco_fine": ArucoDetector(preset="fine"),
    "apriltag": AprilTagDetector(),
    "apriltag_decimate2": AprilTagDetector(quad_decimate=2.0),
}
NOISE = 1.5  # standard deviation, grey levels
MODULES, QUIET = 8, 2
LONG_EDGE = 60.0  # pixels; longer edges may be bent


def tag_picture(number: int) -> FloatArray:
    """Modules of a 36h11 tag as AprilTag publishes it, white margin included: 0 is black, 1 white."""
    bits = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), number, 8)
    return np.pad(np.rot90(bits, 2) > 0, QUIET, constant_values=True).astype(float)


def homography(pitch: float, rng: np.random.Generator) -> tuple[FloatArray, int]:
    """From modules (the black square is 0..8) to pixels, with a random turn, tilt and place; and the image's size."""
    tilt, about, turn = np.radians(rng.uniform(0.0, 55.0)), rng.uniform(0.0, 2 * np.pi), rng.uniform(0.0, 2 * np.pi)
    axis = np.array([np.cos(about), np.sin(about), 0.0])
    rotation = cv2.Rodrigues(tilt * axis)[0] @ cv2.Rodrigues(np.array([0.0, 0.0, turn]))[0]
    # The shorter direction of a tilted tag has this pitch: that is how `CornerErrors` counts.
    scale = pitch / np.cos(tilt)
    distance = 6.0 * MODULES
    half = 0.8 * scale * (MODULES + 2 * QUIET) + 12.0
    to_middle = np.array([[1.0, 0.0, -MODULES / 2], [0.0, 1.0, -MODULES / 2], [0.0, 0.0, 1.0]])
    plane = np.column_stack([rotation[:, 0], rotation[:, 1], [0.0, 0.0, distance]])
    middle = half + rng.uniform(0.0, 1.0, 2)
    camera = np.array([[scale * distance, 0.0, middle[0]], [0.0, scale * distance, middle[1]], [0.0, 0.0, 1.0]])
    return camera @ plane @ to_middle, int(2 * half) + 1


def render(
    picture: FloatArray, into: FloatArray, size: int, blur: float, exposure: str, rng: np.random.Generator
) -> UInt8Array:
    """The picture under a homography, integrated over each pixel; grey beyond its white margin."""
    black, white, power = EXPOSURES[exposure]
    at = (np.arange(size * SAMPLES) + 0.5) / SAMPLES
    u, v = np.meshgrid(at, at)
    x, y, w = np.linalg.inv(into) @ np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    column, row = (np.floor(value / w).astype(int) + QUIET for value in (x, y))
    inside = (column >= 0) & (row >= 0) & (column < len(picture)) & (row < len(picture))
    light = np.full(u.size, black + 0.6 * (white - black))
    light[inside] = black + (white - black) * picture[row[inside], column[inside]]
    samples = gaussian_filter(light.reshape(u.shape), blur * SAMPLES) if blur else light.reshape(u.shape)
    pixels = samples.reshape(size, SAMPLES, size, SAMPLES).mean(axis=(1, 3))
    grey = 255.0 * np.clip(pixels, 0.0, 1.0) ** power + rng.normal(0.0, NOISE, pixels.shape)
    return np.clip(np.round(grey), 0, 255).astype(np.uint8)


def project(into: FloatArray, points: FloatArray) -> FloatArray:
    """Pixels of points `(..., 2)` of the tag's plane."""
    seen = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1) @ into.T
    return np.asarray(seen[..., :2] / seen[..., 2:])


def shift(found: FloatArray, true: FloatArray) -> tuple[FloatArray, float, FloatArray]:
    """Mean offset (x, y) of four corners, how far their four edges lie inward, and what is left of each corner.

    An edge is moved inward by the mean of what its two ends are moved along its normal.
    """
    off = found - true
    along = np.roll(true, -1, axis=0) - true
    # Corners go round clockwise in the image, so this normal leads into the tag.
    inward = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
    ends = (off + np.roll(off, -1, axis=0)) / 2.0
    depth = float((ends * inward).sum(axis=1).mean())
    return off.mean(axis=0), depth, off - off.mean(axis=0)


def measure(
    pitch: float, blur: float, exposure: str, tags: int, seed: int
) -> dict[str, tuple[int, FloatArray, FloatArray]]:
    """For each detector: tags found, their offsets `(K, 2)` and inward shifts `(K,)`."""
    gathered: dict[str, list[tuple[FloatArray, float]]] = {name: [] for name in DETECTORS}
    square = np.array([[0.0, 0.0], [MODULES, 0.0], [MODULES, MODULES], [0.0, MODULES]])
    for number in range(tags):
        rng = np.random.default_rng([seed, number])
        into, size = homography(pitch, rng)
        image = render(tag_picture(number), into, size, blur, exposure, rng)
        true = project(into, square)
        for name, detector in DETECTORS.items():
            found = detector.detect(image)
            for corners in found.corners[found.ids == number][:1]:
                offset, depth, _ = shift(corners, true)
                if np.abs(corners - true).max() < 3.0:
                    gathered[name].append((offset, depth))
    return {
        name: (len(rows), np.array([row[0] for row in rows]).reshape(-1, 2), np.array([row[1] for row in rows]))
        for name, rows in gathered.items()
    }


def fitted_corners(
    image: FloatArray, start: FloatArray, modules: int, bends: bool = True
) -> tuple[FloatArray, float, float] | None:
    """Corners where lines meet that are fitted to the four edges of a black square; blur, pixels; misfit, of the step.

    Each edge is a step between two levels, blurred by a Gaussian, fitted to the pixels themselves: those within 0.8
    modules of it and farther than 0.8 modules from its ends. None where an edge has too few pixels or does not fit.

    Args:
        image: grey levels, in which a step has to be symmetrical.
        start: corners `(4, 2)`, clockwise in the image, right to a pixel or two.
        modules: along an edge.
        bends: whether edges longer than 60 pixels may be bent by the lens; then their tangents at a corner meet there.
    """
    pitch = np.linalg.norm(np.roll(start, -1, axis=0) - start, axis=1).min() / modules
    fits = [_fitted_edge(image, start[k], start[(k + 1) % 4], pitch, bends) for k in range(4)]
    if any(fit is None for fit in fits):
        return None
    lines, blurs, misfits = zip(*(fit for fit in fits if fit is not None), strict=True)
    meet = np.array([np.cross(lines[k - 1][1], lines[k][0]) for k in range(4)])
    return meet[:, :2] / meet[:, 2:], float(np.mean(blurs)), float(np.mean(misfits))


def _fitted_edge(
    image: FloatArray, a: FloatArray, b: FloatArray, pitch: float, bends: bool
) -> tuple[tuple[FloatArray, FloatArray], float, float] | None:
    """Tangents of the edge at a and at b, homogeneous, its blur and its misfit."""
    band, length = min(0.8 * pitch, 8.0), float(np.linalg.norm(b - a))
    along = (b - a) / length
    inward = np.array([-along[1], along[0]])
    low, high = np.floor(np.minimum(a, b) - band), np.ceil(np.maximum(a, b) + band)
    u, v = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    middle = np.stack([u, v], axis=-1).reshape(-1, 2) + 0.5 - a
    s, t = middle @ along, middle @ inward
    some = (np.abs(t) < band) & (s > 0.8 * pitch) & (s < length - 0.8 * pitch)
    rows, columns = v.ravel()[some].astype(int), u.ravel()[some].astype(int)
    if some.sum() < 40 or min(rows.min(), columns.min()) < 0:
        return None
    if rows.max() >= image.shape[0] or columns.max() >= image.shape[1]:
        return None
    s, t, grey = s[some] / length - 0.5, t[some], image[rows, columns]
    bent = float(bends and length > LONG_EDGE)

    def misfit(x: FloatArray) -> FloatArray:
        # x: place, turn, log blur, levels of white and black with their slopes along the edge, bow.
        step = 0.5 * (1.0 + erf((t - x[0] - x[1] * s - bent * x[7] * s**2) / (np.sqrt(2.0) * np.exp(x[2]))))
        return np.asarray((x[3] + x[4] * s) * (1.0 - step) + (x[5] + x[6] * s) * step - grey)

    levels = np.quantile(grey, [0.9, 0.1])
    fit = least_squares(misfit, [0.0, 0.0, 0.0, levels[0], 0.0, levels[1], 0.0, 0.0], loss="soft_l1", f_scale=5.0)
    place, turn, log_blur, white, _, black, _, bow = fit.x
    if abs(place) > 0.5 * band + 1.0 or white - black < 20.0 or np.median(np.abs(misfit(fit.x))) > 0.06 * white:
        return None
    tangents = []
    for end in (-0.5, 0.5):
        point = a + (end + 0.5) * length * along + (place + turn * end + bent * bow * end**2) * inward
        way = length * along + (turn + 2.0 * bent * bow * end) * inward
        tangents.append(np.cross([*point, 1.0], [*(point + way), 1.0]))
    off = float(np.sqrt((misfit(fit.x) ** 2).mean()) / (white - black))
    return (tangents[0], tangents[1]), float(np.exp(log_blur)), off


class ArucoOriginal:
    """`cv2.aruco` for the family ARUCO_ORIGINAL, which `lmd` does not print, with the settings of `ArucoDetector`."""

    def detect(self, image: UInt8Array) -> Detections:
        """See `lmd.detection.detectors.Detector.detect`."""
        settings = cv2.aruco.DetectorParameters()
        settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_ARUCO_ORIGINAL)
        found, ids, _ = cv2.aruco.ArucoDetector(dictionary, settings).detectMarkers(image)
        corners = np.array([one[0] for one in found]).reshape(-1, 4, 2) + 0.5
        return Detections(np.array([] if ids is None else ids).ravel(), corners)


def photographs(folder: Path, family: str) -> None:
    """What detectors find in photographs beside fitted edges, straight or bent, of grey levels stored or linear."""
    detectors: dict[str, Detector] = {"aruco": ArucoOriginal()} if family == "aruco_original" else DETECTORS
    modules = 7 if family == "aruco_original" else MODULES
    rng = np.random.default_rng(0)
    rows: dict[tuple[str, str, str], list[FloatArray]] = {}
    for path in sorted(one for one in folder.iterdir() if one.suffix in (".png", ".jpg")):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        detected = {name: detector.detect(image) for name, detector in detectors.items()}
        for number in sorted({int(i) for found in detected.values() for i in found.ids}):
            all_found = {name: found.corners[found.ids == number] for name, found in detected.items()}
            first = next(corners[0] for corners in all_found.values() if len(corners))
            # Edges are searched from somewhere else than where a detector has them, so that they owe it nothing.
            start = first + rng.uniform(-1.0, 1.0, (4, 2))
            pitch = np.linalg.norm(np.roll(first, -1, axis=0) - first, axis=1).min() / modules
            for edges, levels in product(("straight", "bent"), ("stored", "linear")):
                light = 255.0 * (image / 255.0) ** (1.0 if levels == "stored" else 2.2)
                fit = fitted_corners(light, start, modules, edges == "bent")
                if fit is None or pitch < 4.0 * fit[1]:
                    continue
                for name, corners in all_found.items():
                    if len(corners):
                        offset, depth, _ = shift(corners[0], fit[0])
                        rows.setdefault((name, edges, levels), []).append(np.array([*offset, depth, pitch, *fit[1:]]))
    print("means and standard errors, pixels; pitch, blur and misfit, of the step (medians)")
    for kind, values in sorted(rows.items()):
        table = np.array(values)
        mean, error = table.mean(axis=0), table.std(axis=0, ddof=1) / np.sqrt(len(table))
        cells = [
            f"{name} {mean[k]:+.3f} +- {error[k]:.3f}" for k, name in enumerate(("offset x", "offset y", "inward"))
        ]
        print(
            f"{', '.join(kind)}: {len(table)} tags: {'; '.join(cells)}; {np.round(np.median(table[:, 3:], axis=0), 3)}"
        )


def rendered(tags: int) -> None:
    """The table by pitch and blur in ordinary light, and by exposure at a blur of 0.5 pixels."""
    conditions = [(blur, ORDINARY) for blur in BLURS] + [(0.5, name) for name in EXPOSURES if name != ORDINARY]
    for blur, exposure in conditions:
        print(f"blur {blur} pixels, {exposure}: pitch; of each detector the tags found, offset x, y, inward")
        for pitch in PITCHES:
            cells = []
            for name, (count, offset, depth) in measure(pitch, blur, exposure, tags, 1).items():
                if count >= tags / 2:
                    x, y = offset.mean(axis=0)
                    cells.append(f"{name} {count} {x:+.3f} {y:+.3f} {depth.mean():+.3f}")
            print(f"{pitch:5.1f}  " + "   ".join(cells), flush=True)


def preset(tags: int) -> None:
    """What `CornerErrors` takes: by pitch the mean over blurs in ordinary light, and what all conditions differ by."""
    conditions = list(product(BLURS[:3], EXPOSURES))
    ordinary = [exposure == ORDINARY for _, exposure in conditions]
    depths = np.full((len(DETECTORS), len(PITCH_MIDDLES), len(conditions)), np.nan)
    for at, pitch in enumerate(PITCH_MIDDLES):
        for condition, (blur, exposure) in enumerate(conditions):
            measured = measure(pitch, blur, exposure, tags, 2).values()
            for detector, (count, _, depth) in enumerate(measured):
                if count >= tags / 2:
                    depths[detector, at, condition] = depth.mean()
    for name, own in zip(DETECTORS, depths, strict=True):
        known = ~np.isnan(own[:, ordinary]).all(axis=1)
        inward = np.nanmean(own[known][:, ordinary], axis=1)
        spread = np.sqrt(np.nanmean((own[known] - inward[:, None]) ** 2))
        print(f"{name}: pitch {np.round(PITCH_MIDDLES, 2)[known]}, inward {inward.round(3)}, spread {spread:.3f}")


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("rendered", "preset"):
        commands.add_parser(name).add_argument("--tags", type=int, default=60)
    real = commands.add_parser("photographs")
    real.add_argument("folder", type=Path)
    real.add_argument("family", choices=("36h11", "aruco_original"))
    chosen = parser.parse_args()
    if chosen.command == "photographs":
        photographs(chosen.folder, chosen.family)
    else:
        {"rendered": rendered, "preset": preset}[chosen.command](chosen.tags)


if __name__ == "__main__":
    main()
