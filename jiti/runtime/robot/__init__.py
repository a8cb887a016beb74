"""Robots that are not simulated, and the virtual one that stands in for them."""
