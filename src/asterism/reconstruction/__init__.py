"""3D clouds from the blobs of calibrated cameras."""

from asterism.reconstruction.reconstruct import reconstruct
from asterism.reconstruction.result import Reconstruction
from asterism.reconstruction.settings import METHODS, ReconstructionSettings
from asterism.reconstruction.streaming import Reconstructor
from asterism.reconstruction.summary import summary

__all__ = ["METHODS", "Reconstruction", "ReconstructionSettings", "Reconstructor", "reconstruct", "summary"]
