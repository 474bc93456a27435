"""Localisation as an objective: how often one image tells where the camera is to within a tolerance."""

from lmd.objectives.localisation.objective import Localisation, localisation

__all__ = ["Localisation", "localisation"]
