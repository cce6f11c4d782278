"""3D clouds from the blobs of calibrated cameras."""

from asterism.reconstruction.reconstruct import METHODS, reconstruct
from asterism.reconstruction.result import Reconstruction
from asterism.reconstruction.summary import summary

__all__ = ["METHODS", "Reconstruction", "reconstruct", "summary"]
