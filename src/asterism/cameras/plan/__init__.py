"""A volume, a number of cameras and where they may hang in; a proposal for where to hang them out (thesis 3.2)."""

from asterism.cameras.plan.mounts import Mounts, focal_length
from asterism.cameras.plan.search import RigPlan, plan_rig

__all__ = ["Mounts", "RigPlan", "focal_length", "plan_rig"]
