"""Detections: the corners of tags in the frames of one or several cameras."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray

SAME = 0.01  # maximum difference between the corners of copies, pixels


@dataclass(frozen=True)
class DetectedTags:
    """N detections of tags in F frames of C cameras; a detection is one tag in one image.

    Args:
        times: texts of the frames, their times or their names, ascending and all different. Simultaneous images of
            several cameras are one frame.
        cameras: names of the cameras, `(C,)`.
        frame: index of the frame of each detection, `(N,)`.
        camera: index of the camera of each detection, `(N,)`.
        ids: number of the tag of each detection, `(N,)`.
        corners: corners in the image, pixels from the outer corner of its top left pixel, in the order top left, top
            right, bottom right, bottom left of the tag, `(N, 4, 2)`.
        blurred: blur, pixels, of each frame whose detections were left out because of blur, keyed by the frame's name.
        copies: names of original images, keyed by the name of the copy whose detections were left out.
        in_order: True if corners are known to begin at the top left, as a detector of `lmd.detection` ensures.
        taken: True where a camera has a valid image of a frame, with or without tags, `(F, C)`; None if all cameras
            have images of all frames.
        left_out: names of the frames whose detections were left out as redundant.
        family: family of the tags; None if unknown.

    Raises:
        InputError: shapes do not match, or there is no detection.
    """

    times: tuple[str, ...]
    cameras: tuple[str, ...]
    frame: IntArray
    camera: IntArray
    ids: IntArray
    corners: FloatArray
    blurred: Mapping[str, float] = field(default_factory=dict)
    copies: Mapping[str, str] = field(default_factory=dict)
    in_order: bool = False
    taken: BoolArray | None = None
    left_out: tuple[str, ...] = ()
    family: str | None = None

    def __post_init__(self) -> None:
        count = len(self.ids)
        if not count:
            raise InputError("detections has no tag.", "detections")
        if self.corners.shape != (count, 4, 2) or self.frame.shape != (count,) or self.camera.shape != (count,):
            raise InputError(f"detections need four corners each, got {self.corners.shape} for {count} detections.")

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def images(self) -> BoolArray:
        """Mask of the frames in which each camera has an image, `(F, C)`: `taken`, or True everywhere if `taken` is
        None.
        """
        return np.ones((len(self.times), len(self.cameras)), dtype=bool) if self.taken is None else self.taken

    @classmethod
    def in_frames(cls, names: Sequence[str], ids: Sequence[IntArray], corners: Sequence[FloatArray]) -> "DetectedTags":
        """Make the detections of one camera from the ids and corners in each frame.

        Args:
            names: names of the frames, in ascending order.
            ids: ids of the M tags in each frame, `(M,)`.
            corners: corners of these tags, `(M, 4, 2)`, in the order and unit of `corners` of this class.

        Raises:
            InputError: there is no tag in any frame.
        """
        frame = np.repeat(np.arange(len(ids)), [len(own) for own in ids])
        all_ids = np.concatenate([np.empty(0, dtype=np.int64), *ids])
        all_corners = np.concatenate([np.empty((0, 4, 2)), *corners])
        camera = np.zeros(len(all_ids), dtype=np.int64)
        return cls(tuple(names[: len(ids)]), ("",), frame, camera, all_ids, all_corners, in_order=True)

    @classmethod
    def together(cls, parts: Mapping[str, "DetectedTags"]) -> "DetectedTags":
        """Merge the detections of several cameras; frames with equal names become one frame.

        Args:
            parts: detections of each camera, keyed by the camera's name, with the names in ascending order.
        """
        times = sorted({time for part in parts.values() for time in part.times})
        places = [np.searchsorted(times, part.times)[part.frame] for part in parts.values()]
        camera = np.repeat(np.arange(len(parts)), [len(part) for part in parts.values()])
        ids, corners = (np.concatenate([getattr(part, name) for part in parts.values()]) for name in ("ids", "corners"))
        blurs = {f"{name}/{time}": blur for name, part in parts.items() for time, blur in part.blurred.items()}
        in_order = all(part.in_order for part in parts.values())
        sharp = [sorted(set(part.times) - set(part.blurred)) for part in parts.values()]
        taken = np.stack([np.isin(times, names) for names in sharp], axis=1)
        cameras = tuple(parts)
        return cls(
            tuple(times), cameras, np.concatenate(places), camera, ids, corners, blurs, in_order=in_order, taken=taken
        )

    def of(self, chosen: IntArray) -> "DetectedTags":
        """The detections with the indices `chosen`; the lists of frames and cameras are unchanged."""
        names = ("frame", "camera", "ids", "corners")
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})

    def renumbered(self, ids: IntArray, quarters: IntArray) -> "DetectedTags":
        """Copy of the detections in which the corners of K tags are counted from another corner.

        Args:
            ids: ids of the K tags, ascending, `(K,)`.
            quarters: for each of the K tags, the new index (0 to 3) of the corner that had the index 0, `(K,)`.
        """
        place = np.minimum(np.searchsorted(ids, self.ids), len(ids) - 1)
        back = np.where(ids[place] == self.ids, quarters[place], 0)
        order = (np.arange(4) - back[:, None]) % 4
        return replace(self, corners=np.take_along_axis(self.corners, order[..., None], axis=1))

    def without(self, blurs: Mapping[str, float]) -> "DetectedTags":
        """Copy without the detections in blurred frames.

        `blurs` is the blur of each blurred frame, pixels, keyed by the frame's name. The blur is added to the field
        `blurred`.

        Raises:
            InputError: no detection is left.
        """
        left_out = np.isin(self.times, list(blurs))
        return replace(self.of(np.flatnonzero(~left_out[self.frame])), blurred={**self.blurred, **blurs})


def signed_area(corners: FloatArray) -> FloatArray:
    """Signed area `(...)` of quadrilaterals `(..., 4, 2)`, positive if their corners are clockwise in the image."""
    x, y = corners[..., 0], corners[..., 1]
    return np.asarray((x * np.roll(y, -1, axis=-1) - np.roll(x, -1, axis=-1) * y).sum(axis=-1) / 2.0)


def without_copies(detected: DetectedTags) -> DetectedTags:
    """Leave out the detections in copies of images; the field `copies` of the result names the copies.

    An image is a copy if it shows the same tags as an earlier image of its camera, and coordinates of corners differ by
    at most `SAME` pixels. Errors of corners are independent in two photographs, but equal in a photograph and its copy.
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
