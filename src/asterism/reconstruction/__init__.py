"""3D clouds from the blobs of calibrated cameras."""

from asterism.reconstruction.reconstruct import METHODS, reconstruct
from asterism.reconstruction.refine import CameraCheck, Refinement, refine_rig
from asterism.reconstruction.result import Reconstruction
from asterism.reconstruction.summary import summary

__all__ = ["METHODS", "CameraCheck", "Reconstruction", "Refinement", "reconstruct", "refine_rig", "summary"]
