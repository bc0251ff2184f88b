"""The pair: two submaps as surfaces, what joins them, and the verdict.

Other features may draw on its scene and repeat its verdict, and know nothing else of it.
"""

from app.viewer.features.pair.picture import PairDrawing, Picture, boxes_of, compose
from app.viewer.features.pair.scene import PAIR, PairScene
from app.viewer.features.pair.verdict import (
    BY_HAND,
    figures_of,
    headline_of,
    in_words,
    sentences_of,
    whole_sentence,
)

__all__ = [
    "BY_HAND",
    "PAIR",
    "PairDrawing",
    "PairScene",
    "Picture",
    "boxes_of",
    "compose",
    "figures_of",
    "headline_of",
    "in_words",
    "sentences_of",
    "whole_sentence",
]
