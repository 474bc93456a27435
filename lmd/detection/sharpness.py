"""How blurred an image is, by the edges of the tags in it.

Across the outer edge of a tag's black border the image goes from white to black. Between 16 and 84 % of that step lie
two standard deviations of the blur. A camera that moves blurs the edges across its way, and leaves those along it
sharp.
"""

import numpy as np

from lmd.core.checks import BoolArray, FloatArray
from lmd.detection.detectors import Detections
from lmd.render.imaging import UInt8Array

LEAST_PITCH = 3.0  # pixels a module, of tags whose edges are asked
WIDEST_EDGE = 12.0  # pixels from an edge, at most, that are looked at
SAMPLES, STEPS = 12, 65  # along an edge, and across it
EDGE_PART = (0.2, 0.8)  # the part of an edge that is asked: corners are round
LOW, HIGH = 0.16, 0.84
# A frame is blurred if it is so by so many times as much as most, and by so much, pixels.
TIMES, LEAST = 2.0, 1.0


def blur_of(image: UInt8Array, found: Detections, modules: int) -> float:
    """The standard deviation of the blur across the second most blurred edge of a tag, pixels: the median over tags.

    NaN where no tag is large enough.

    Args:
        found: what was detected in it.
        modules: N of the tags' family.
    """
    from scipy.ndimage import map_coordinates

    starts, ends = found.corners, np.roll(found.corners, -1, axis=1)  # clockwise, so outside is to the left
    along = ends - starts
    lengths = np.linalg.norm(along, axis=-1)
    pitch = lengths.min(axis=1) / modules
    own = pitch >= LEAST_PITCH
    if not own.any():
        return float("nan")
    starts, along, lengths, pitch = starts[own], along[own], lengths[own], pitch[own]
    outwards = np.stack([along[..., 1], -along[..., 0]], axis=-1) / lengths[..., None]
    reach = np.minimum(0.9 * pitch, WIDEST_EDGE)
    offsets = np.linspace(-1.0, 1.0, STEPS)
    middle = starts[:, :, None] + np.linspace(*EDGE_PART, SAMPLES)[:, None] * along[:, :, None]  # (M, 4, S, 2)
    places = (
        middle[:, :, :, None] + (reach[:, None, None] * offsets[:, None])[:, None, None] * outwards[:, :, None, None]
    )
    grey = map_coordinates(
        image.astype(np.float64), np.moveaxis(places[..., ::-1] - 0.5, -1, 0), order=1, mode="nearest"
    )
    profile = np.maximum.accumulate(grey.mean(axis=2), axis=-1)  # from black to white
    low, high = profile[..., :1], profile[..., -1:]
    step = (profile - low) / np.maximum(high - low, 1.0)
    width = ((step < HIGH) & (step >= LOW)).sum(axis=-1) * (2.0 * reach / (STEPS - 1))[:, None] / 2.0
    return float(np.median(np.sort(width, axis=1)[:, -2]))


def blurred(blurs: FloatArray) -> BoolArray:
    """Which frames are blurred beside the others, from the blur of each, `(F,)`; NaN is not."""
    known = blurs[np.isfinite(blurs)]
    usual = np.median(known) if known.size else np.inf
    return np.asarray(np.nan_to_num(blurs) > max(TIMES * usual, LEAST))
