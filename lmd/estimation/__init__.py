"""Localisation on simulated flights: sensors, estimators, and the Cramer-Rao bound."""
