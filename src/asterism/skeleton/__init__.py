"""A body: its model, a person's own, its movement; and virtual people.

Labelled trials of a person in; the person's skeleton, and its joints' coordinates over time, out (`person`, `inverse_kinematics`).
A marker set in; labelled recordings of virtual people who wear it out. A labelled recording in; where its markers sit, out
(`place_learning`).

The body of a virtual person is a skeleton of 19 segments, posed by joint angles within human limits; its markers sit where the marker set
says, moved as hands and skin move them. Of real people they have typical postures and habits, in numbers, and nothing else.
"""

from asterism.skeleton.body import ArticulatedBody, BodyMarker, Bone, Capsule, Hinge
from asterism.skeleton.body_file import load_body, save_body, shipped_bodies
from asterism.skeleton.body_fit import fit_body
from asterism.skeleton.build import BuildRules
from asterism.skeleton.counterparts import counterparts, with_markers_of
from asterism.skeleton.inverse_kinematics import FollowedTree, Kinematics, KinematicsRules, solve_kinematics
from asterism.skeleton.movements import MOVEMENTS
from asterism.skeleton.osim_file import load_osim
from asterism.skeleton.people import VirtualRules, virtual_people
from asterism.skeleton.person import FittedPerson, PersonRules, fit_person
from asterism.skeleton.place_learning import LearnedPlaces, learn_places, marker_set_of, place_by_name, with_landmarks
from asterism.skeleton.tree import KinematicTree, tree_of
from asterism.skeleton.worn import WearRules

__all__ = [
    "MOVEMENTS",
    "ArticulatedBody",
    "BodyMarker",
    "Bone",
    "BuildRules",
    "Capsule",
    "FittedPerson",
    "FollowedTree",
    "Hinge",
    "KinematicTree",
    "Kinematics",
    "KinematicsRules",
    "LearnedPlaces",
    "PersonRules",
    "VirtualRules",
    "WearRules",
    "counterparts",
    "fit_body",
    "fit_person",
    "learn_places",
    "load_body",
    "load_osim",
    "marker_set_of",
    "place_by_name",
    "save_body",
    "shipped_bodies",
    "solve_kinematics",
    "tree_of",
    "virtual_people",
    "with_landmarks",
    "with_markers_of",
]
