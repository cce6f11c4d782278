"""Images of cameras in, read and searched in processes of their own; blobs out."""

from asterism.live.images.workers import CameraWorkers, WorkerSettings

__all__ = ["CameraWorkers", "WorkerSettings"]
