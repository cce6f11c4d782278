"""Points of people who wear no set that was named in; the shipped marker set that they wear out."""

from asterism.session.worn.find import BY_NAMES, BY_POINTS, FRAMES_TO_FIND, GIVEN, FindRules, NoSetWorn, SetFinder, WornMarkers

__all__ = ["BY_NAMES", "BY_POINTS", "FRAMES_TO_FIND", "GIVEN", "FindRules", "NoSetWorn", "SetFinder", "WornMarkers"]
