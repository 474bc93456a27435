"""Counts and probabilities of many deployments in one scene, on the fast exact path."""

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from lmd.checks import FloatArray
from lmd.coverage import kernels
from lmd.coverage.kernels import PROBABILITY_ONE
from lmd.deployment import Deployment
from lmd.scene import Scene
from lmd.visibility import TOLERANCE


def available_threads() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Evaluator:
    """Evaluates deployments at every position of a scene.

    Args:
        scene: what stays fixed.
        positions: `(P, 3)` camera positions, metres; the room's grid by default.
        threads: worker threads; all available processors by default. Results do not depend on it.
    """

    def __init__(self, scene: Scene, positions: FloatArray | None = None, threads: int | None = None) -> None:
        limits, visibility = scene.limits, scene.visibility
        self.positions = np.ascontiguousarray(scene.room.grid() if positions is None else positions)
        self.threads = threads or available_threads()
        self.axis_of = scene.pdf.axis_of
        self.axes = kernels.in_blocks(scene.pdf.axes.T)
        self.index = kernels.height_index(scene.pdf.axes[:, 2])
        self.weights = np.rint(kernels.in_blocks(scene.pdf.axis_weight) * PROBABILITY_ONE).astype(np.int64)
        # What rounding left over goes to the heaviest axis, so that certainty is exactly one.
        self.weights[np.argmax(self.weights)] += PROBABILITY_ONE - self.weights.sum()
        self.limits = np.array([limits.min_cosine, limits.min_depth, limits.max_depth])
        self.reach = (visibility.nu * (1.0 + TOLERANCE)) ** 2
        self.mode = kernels.OCCLUSION_CODES[visibility.occlusion if visibility.tests_other_landmarks else "none"]

    def counts(self, deployment: Deployment) -> np.ndarray:
        """Landmarks covered at every position and orientation of the PDF, `(P, A)` int32."""
        out = np.empty((1, len(self.positions), self.axes.shape[1]), dtype=np.int32)
        self._run(kernels.counts_in_range, deployment.positions[None], deployment.normals[None], out)
        return np.asarray(out[0][:, self.axis_of])

    def units(self, positions: FloatArray, normals: FloatArray, n: int) -> np.ndarray:
        """P_n at every position in units of 1 / `PROBABILITY_ONE`.

        Args:
            positions, normals: `(B, K, 3)` landmarks of B deployments.
            n: landmarks that must be covered.

        Returns:
            `(B, P)` int64.
        """
        out = np.empty((len(positions), len(self.positions)), dtype=np.int64)
        self._run(kernels.units_in_range, positions, normals, self.weights, n, out)
        return out

    def probabilities(self, deployment: Deployment, n: int) -> FloatArray:
        """P_n at every position, `(P,)`."""
        units = self.units(deployment.positions[None], deployment.normals[None], n)
        return np.asarray(units[0] / PROBABILITY_ONE)

    def _run(self, kernel: Callable[..., None], positions: FloatArray, normals: FloatArray, *rest: object) -> None:
        """Run `kernel` over all positions, shared between threads."""
        landmarks = np.ascontiguousarray(positions.transpose(0, 2, 1))
        facing = np.ascontiguousarray(normals.transpose(0, 2, 1))
        scene = (self.positions, landmarks, facing, self.limits, self.reach, self.mode, self.axes, self.index)
        edges = np.linspace(0, len(self.positions), self.threads + 1).astype(int)
        if self.threads == 1:
            kernel(0, len(self.positions), *scene, *rest)
            return
        with ThreadPoolExecutor(self.threads) as pool:
            jobs = [pool.submit(kernel, a, b, *scene, *rest) for a, b in itertools.pairwise(edges)]
            for job in jobs:
                job.result()
