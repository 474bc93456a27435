"""Landmark deployment: where to put directional landmarks so that a moving camera sees enough of them."""
