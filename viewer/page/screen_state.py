"""Sentences as values."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Tone(Enum):
    """The kind of a sentence, which gives its colour."""

    PLAIN = "plain"
    GOOD = "good"
    WARM = "warm"
    BAD = "bad"


@dataclass(frozen=True, slots=True)
class Sentence:
    """The status sentence: what is going on, or what to do now."""

    text: str
    tone: Tone = Tone.PLAIN
