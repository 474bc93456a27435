"""Tags seen by each camera of a rig from every pose of its body, as bit sets; a rig sees the union of its cameras."""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lmd.core.bits import packed
from lmd.core.threads import in_parts
from lmd.geometry.camera import Camera
from lmd.scene.deployment import Deployment
from lmd.scene.rig import Mount, Rig
from lmd.sight.evaluator import Evaluator
from lmd.sight.views import visible

MOST_BYTES = 1 << 28  # greatest memory of cached views, bytes; above it, the least recently used views are dropped
PARTS_PER_THREAD = 4  # number of chunks per thread


class CameraViews:
    """Cache of the views of single cameras; only a camera with a new mount is evaluated.

    Args:
        evaluator: evaluator of a rig, with the positions and orientations of the body.
        deployment: K tags.
    """

    def __init__(self, evaluator: Evaluator, deployment: Deployment) -> None:
        self._evaluator, self._deployment = evaluator, deployment
        axes = evaluator.scene.orientations.axes
        weights = np.broadcast_to(evaluator.weights[:, : len(axes)], (len(evaluator.positions), len(axes)))
        self._position, self._orientation = np.nonzero(weights)  # poses with a positive probability, (N,) each
        self._weights = weights[self._position, self._orientation]
        self._axes = axes
        self._of_camera: dict[Camera, Evaluator] = {}
        self._kept: OrderedDict[Mount, np.ndarray] = OrderedDict()

    def _alone(self, camera: Camera) -> Evaluator:
        """Evaluator of the scene with a single camera; its positions are not used."""
        if camera not in self._of_camera:
            scene = replace(self._evaluator.scene, camera=camera)
            self._of_camera[camera] = Evaluator(scene, self._evaluator.positions[:1], threads=1)
        return self._of_camera[camera]

    def knows(self, mount: Mount) -> bool:
        """True if the views of a mount are cached."""
        return mount in self._kept

    def visible_tags(self, mount: Mount) -> np.ndarray:
        """Tags that a camera sees from the N poses of the body, bit sets `(N, W)`."""
        if mount not in self._kept:
            self._kept[mount] = self._look(mount)
            size = 8 * (1 + (len(self._deployment) - 1) // 64) * len(self._position)
            while len(self._kept) > max(MOST_BYTES // size, 8):
                self._kept.popitem(last=False)
        self._kept.move_to_end(mount)
        return self._kept[mount]

    def _look(self, mount: Mount) -> np.ndarray:
        (offsets,), (turned,) = Rig((mount,)).views(self._axes)
        alone, n = self._alone(mount.camera), len(self._position)
        places = self._evaluator.positions[self._position] + offsets[self._orientation]
        axes, found = turned[self._orientation], np.empty((n, len(self._deployment)), dtype=np.bool_)

        def look(first: int, last: int) -> None:
            found[first:last] = visible(alone, self._deployment, places[first:last], axes[first:last])

        in_parts(self._evaluator.threads, look, n, PARTS_PER_THREAD * self._evaluator.threads)
        return packed(found)

    def units(self, mounts: Sequence[Mount], n: int) -> np.ndarray:
        """Quantised P_n at each position, `(P,)`."""
        union = np.uint64(0)
        for mount in mounts:
            union = union | self.visible_tags(mount)  # type: ignore[assignment] # an array from the first on
        enough = np.bitwise_count(union).sum(axis=-1) >= n
        # Sums of integers up to 2^52 are exact in float64.
        summed = np.bincount(self._position, self._weights * enough, len(self._evaluator.positions))
        return summed.astype(np.int64)
