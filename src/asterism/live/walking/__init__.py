"""Feet and pelvis as they come in; heel strikes, toe offs and what steps are like, out."""

from asterism.live.walking.events import LiveEvents
from asterism.live.walking.steps import LiveSteps

__all__ = ["LiveEvents", "LiveSteps"]
