"""Localisation: the camera's position is known to within a tolerance, with a probability as large as can be."""

import itertools
import math
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from lmd.checks import BoolArray, FloatArray, InputError, choice, integer, real
from lmd.objectives.base import Headline
from lmd.objectives.coverage import Threshold
from lmd.objectives.coverage_field import coverage_field
from lmd.objectives.field import smoothed, worth
from lmd.objectives.information import precision
from lmd.objectives.localisation_field import LocalisationField, mixed
from lmd.objectives.localisation_kernels import localised_views
from lmd.objectives.log_det import LogDeterminant
from lmd.objectives.sampling import Sampling
from lmd.scene import Scene
from lmd.sight.criteria import TOLERANCE
from lmd.sight.evaluator import Evaluator
from lmd.sight.kernels import PROBABILITY_ONE

FITNESS = ("mean", "qualified")
# Fewer orientations than for coverage, as each costs more; drawn anew on the way, they need not be many.
SAMPLING = Sampling(positions=2, divisions=12)
