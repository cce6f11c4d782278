"""A person's skeleton over time and a character's skeleton in; the character that moves as the person, with feet that do not slide, out."""

from asterism.skeleton.retargeting.body_parts import BodyParts, body_parts
from asterism.skeleton.retargeting.contacts import FootContacts, find_contacts
from asterism.skeleton.retargeting.mapping import Retargeted, retarget
from asterism.skeleton.retargeting.measures import FeetErrors, feet_errors

__all__ = ["BodyParts", "FeetErrors", "FootContacts", "Retargeted", "body_parts", "feet_errors", "find_contacts", "retarget"]
