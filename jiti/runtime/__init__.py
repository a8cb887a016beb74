"""Robots that act: demonstrations in simulation."""
