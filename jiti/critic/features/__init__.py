"""Frozen features of observations: who makes them, and where they are kept.

A critic sees an observation through a `FeatureExtractor`, which is named by a text: `state` (the default: the
dataset's own state vectors), `smolvla:PATH_OR_HUB_ID`, `groot:PATH_OR_HUB_ID`, or `policy:PATH_OR_HUB_ID` for any other
policy of lerobot. Training reads them from a cache (`cache.py`), rollouts ask the extractor itself.
"""

from jiti.critic.features.base import Batch, FeatureExtractor, Shapes, open_extractor

__all__ = ["Batch", "FeatureExtractor", "Shapes", "open_extractor"]
