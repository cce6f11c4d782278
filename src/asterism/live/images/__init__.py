"""Images of cameras in, read and searched in processes of their own; blobs out."""

from asterism.live.images.videos import videos_together
from asterism.live.images.worker import CameraPlace, WorkerSettings
from asterism.live.images.workers import CameraWorkers

__all__ = ["CameraPlace", "CameraWorkers", "WorkerSettings", "videos_together"]
