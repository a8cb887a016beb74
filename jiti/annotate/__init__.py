"""Segments and their store, the annotator (ESA), proposals and agreement."""
