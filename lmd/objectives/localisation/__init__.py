"""Localisation as an objective: the probability that one image gives the camera's position to a tolerance."""

from lmd.objectives.localisation.objective import Localisation, localisation

__all__ = ["Localisation", "localisation"]
