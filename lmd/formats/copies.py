"""Images that show the same as others.

The errors of corners in two photographs are independent, in a photograph and its copy they are the same.
"""

from dataclasses import replace

import numpy as np

from lmd.core.checks import FloatArray
from lmd.formats.detections import DetectedTags

SAME = 0.01  # pixels that corners of copies differ by, at most


def without_copies(detected: DetectedTags) -> DetectedTags:
    """Those of images that differ from all earlier ones of their camera; the others are in `copies`, by their names.

    The image of a camera in a frame is a copy where it shows the same tags, each corner `SAME` or less away.
    """
    x, y = detected.corners[:, 0, 0], detected.corners[:, 0, 1]
    order = np.lexsort((y, x, detected.ids, detected.frame, detected.camera))
    image = np.stack([detected.camera, detected.frame], axis=1)[order]
    begins = np.flatnonzero(np.any(np.diff(image, axis=0, prepend=-1), axis=1))
    kept: list[np.ndarray] = []
    copies = {}
    taken = detected.images.copy()
    first: dict[tuple[int, ...], tuple[list[str], FloatArray, int]] = {}
    for own in np.split(order, begins[1:]):
        camera, corners = int(detected.camera[own[0]]), detected.corners[own].ravel()
        name = detected.times[detected.frame[own[0]]]
        called = f"{detected.cameras[camera]}/{name}" if len(detected.cameras) > 1 else name
        key = (camera, *detected.ids[own].tolist())
        names, known, count = first.get(key, ([], np.empty((4, len(corners))), 0))
        near = np.flatnonzero(np.abs(known[:count, 0] - corners[0]) <= SAME)
        same = near[(np.abs(known[near] - corners) <= SAME).all(axis=1)]
        if same.size:
            copies[called] = names[same[0]]
            taken[detected.frame[own[0]], camera] = False
            continue
        if count == len(known):
            known = np.concatenate([known, np.empty_like(known)])
        known[count] = corners
        names.append(called)
        first[key] = names, known, count + 1
        kept.append(own)
    return replace(detected.of(np.sort(np.concatenate(kept))), copies=copies, taken=taken)
